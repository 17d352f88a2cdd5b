"""The exceptions of moteslam: each names the file, the field and what was expected.

The command line prints ``str(error)`` as one line and exits with code 2; no traceback reaches a user.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike


class MoteslamError(Exception):
    """What is wrong with an input, in one line: ``problem``, what was found and expected, without a full stop.

    ``field`` is the array, key or option within the file or folder, ``line`` that of a text file from 1 on.
    """

    def __init__(
        self,
        problem: str,
        *,
        file: str | PathLike[str] | None = None,
        field: str | None = None,
        line: int | None = None,
    ) -> None:
        self.problem = problem
        self.file = None if file is None else str(file)
        self.field = field
        self.line = line
        place = self.file or ""
        if line is not None:
            place += f":{line}" if place else f"line {line}"
        message = ": ".join(part for part in (place, field, problem) if part)
        super().__init__("\\n".join(message.splitlines()))  # names from files may hold line breaks


class InputError(MoteslamError):
    """A recording, map, trajectory or folder that cannot be read as what it should be."""


class ConfigError(MoteslamError):
    """A configuration, scenario or platform with an unknown key or a value out of bounds."""


class OutputError(MoteslamError):
    """A result that cannot be written: the folder exists, is read-only, or the disk is full."""


class ExistsError(OutputError):
    """A target that exists already, where it was not asked to replace it."""


class MoteslamWarning(UserWarning):
    """Something that a user should know of and that stops nothing, in one line; the command line prints it."""


class BackendError(MoteslamError):
    """Taichi cannot run on the backend asked for."""


@contextmanager
def in_file(file: str | PathLike[str]) -> Iterator[None]:
    """Errors of the block that name neither file nor option name this file, as the user wrote it."""
    try:
        yield
    except MoteslamError as error:
        if error.file is not None or (error.field or "").startswith("--"):
            raise
        raise type(error)(error.problem, file=file, field=error.field) from error
