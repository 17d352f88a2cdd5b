"""What the command line says: results on stdout, the rest on stderr, and names of files exactly as they are."""

from __future__ import annotations

import json
import sys
import unicodedata
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from moteslam.errors import OutputError

STDOUT = "stdout"
"""What errors call it."""


def literal(text: object) -> str:
    r"""Text in one line that a terminal shows and does not obey.

    Control characters, line breaks and reversals of the writing direction are written as escapes (``\x1b``), and so
    are the bytes of a file name that is no text (``\xe9``); everything else, brackets of markup too, stays as it is.
    """
    return "".join(map(_literal, str(text)))


def _literal(character: str) -> str:
    if "\udc80" <= character <= "\udcff":  # how Python writes a byte that is no text
        return f"\\x{ord(character) - 0xDC00:02x}"
    if unicodedata.category(character) in ("Cc", "Cf", "Cs", "Co", "Cn", "Zl", "Zp"):
        return character.encode("unicode_escape").decode("ascii")
    return character


def say(text: str = "") -> None:
    """A line of the result, on stdout."""
    with _stdout_named():
        sys.stdout.write(text + "\n")


def say_json(value: Any) -> None:
    """The result as JSON on stdout; numbers that are not finite become null."""
    say(json.dumps(_plain(value), indent=2, allow_nan=False))


def flush() -> None:
    """Write out what was said.

    Raises:
        OutputError: nobody can take it, as ``say`` where much was said; but a closed pipe is a ``BrokenPipeError``.
    """
    with _stdout_named():
        sys.stdout.flush()


@contextmanager
def _stdout_named() -> Iterator[None]:
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=STDOUT) from error


def note(text: object) -> None:
    """A line about the run, on stderr: a warning or an error."""
    sys.stderr.write(f"moteslam: {literal(text)}\n")


def table(rows: Sequence[Sequence[str]], *, right: Sequence[int] = ()) -> str:
    """Rows of text as columns, two spaces apart; the columns named in ``right`` are flush right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join(
        "  ".join(
            cell.rjust(width) if index in right else cell.ljust(width)
            for index, (cell, width) in enumerate(zip(row, widths, strict=True))
        ).rstrip()
        for row in rows
    )


def _plain(value: Any) -> Any:
    """The value with strings that JSON readers accept and without infinities."""
    if isinstance(value, dict):
        return {str(key): _plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item) for item in value]
    if isinstance(value, float) and not abs(value) < float("inf"):
        return None
    return value
