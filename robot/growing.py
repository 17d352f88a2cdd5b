"""Files that another program is still writing: what was appended, and whether it is still the same file."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path
from typing import IO

from moteslam.errors import InputError
from moteslam.robot.reading import open_regular

_SEEN = 64
"""Bytes before the place that was read to, by which a file that was written anew is known."""


class GrowingFile:
    """A file to which another program appends.

    It is opened anew at every look: nothing stays open in between, and a file put in its place is seen.

    Args:
        path: of the file, which exists.
        expected: what it should be, for messages: ``a CARMEN log``.

    Attributes:
        path: as given.
        position: bytes that were taken.
    """

    def __init__(self, path: str | PathLike[str], expected: str) -> None:
        self.path, self.position = Path(path), 0
        self._expected = expected
        self._identity: tuple[int, int] | None = None
        self._seen = b""

    @contextmanager
    def opened(self) -> Iterator[tuple[IO[bytes], int]]:
        """The file for reading, at `position`, and its size now [bytes].

        Raises:
            InputError: it is gone, was replaced, is shorter than what was taken, or cannot be read.
        """
        try:
            with open_regular(self.path, self._expected) as file:
                status = os.fstat(file.fileno())
                identity = (status.st_dev, status.st_ino)
                if self._identity not in (None, identity):
                    raise InputError("was replaced while it was read, expected it to grow", file=self.path)
                self._identity = identity
                if status.st_size < self.position:
                    problem = f"has {status.st_size} bytes, {self.position} were read; expected it to grow"
                    raise InputError(problem, file=self.path)
                file.seek(self.position - len(self._seen))
                if file.read(len(self._seen)) != self._seen:
                    raise InputError("was written anew while it was read, expected it to grow", file=self.path)
                yield file, status.st_size
        except OSError as error:
            raise InputError(f"{error.strerror or error}, expected {self._expected}", file=self.path) from error

    def take(self, file: IO[bytes], position: int) -> None:
        """Everything before a position was read, and is not read again."""
        file.seek(max(0, position - _SEEN))
        self.position, self._seen = position, file.read(position - file.tell())

    def appended(self, size: int) -> Iterator[bytes]:
        """What was appended since the last call, ``size`` bytes at a time.

        Raises:
            InputError: as `opened`.
        """
        with self.opened() as (file, end):
            while self.position < end:
                file.seek(self.position)
                chunk = file.read(min(size, end - self.position))
                if not chunk:
                    return
                self.take(file, self.position + len(chunk))
                yield chunk
