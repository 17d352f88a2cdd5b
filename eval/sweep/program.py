"""Programs of others, run to their end; what they print says what was wrong."""

from __future__ import annotations

import subprocess
from collections.abc import Sequence
from pathlib import Path

from moteslam.errors import InputError

TAIL = 300
"""Characters of the last line that a program printed that go into the error."""
LONGEST_LINE = 200
"""Characters of a version."""


def run_program(words: Sequence[str], folder: Path | None = None) -> str:
    """Run a program to its end, without input.

    Args:
        words: the program and its arguments.
        folder: in which it is run; None for the present one.

    Returns:
        what it wrote to stdout.

    Raises:
        InputError: it is not there, or fails; with the last line that it printed.
    """
    try:
        done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError as error:
        raise InputError(f"cannot be run: {error.strerror or error}", file=words[0]) from error
    if done.returncode:
        printed = (done.stderr or done.stdout).decode("utf-8", errors="replace").strip().splitlines()
        last = f": {printed[-1][-TAIL:]}" if printed else ""
        raise InputError(f"ended with exit code {done.returncode}{last}", file=words[0])
    return done.stdout.decode("utf-8", errors="replace")


def first_line(words: Sequence[str]) -> str:
    """The first line that a program prints, without the spaces around it.

    Raises:
        InputError: it is not there, fails, or prints none.
    """
    line = next((line.strip() for line in run_program(words).splitlines() if line.strip()), "")
    if not line:
        raise InputError("printed nothing, expected a version", file=words[0])
    return line[:LONGEST_LINE]
