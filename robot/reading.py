"""Reading files that nobody vouches for: regular files alone, up to a size, as bytes or as text."""

from __future__ import annotations

import os
import stat
from os import PathLike
from typing import IO

from moteslam.errors import InputError, MoteslamError

_KINDS = {
    stat.S_IFDIR: "is a folder",
    stat.S_IFIFO: "is a named pipe",
    stat.S_IFCHR: "is a device",
    stat.S_IFBLK: "is a device",
    stat.S_IFSOCK: "is a socket",
}


def open_regular(path: str | PathLike[str], expected: str, *, error: type[MoteslamError] = InputError) -> IO[bytes]:
    """Open a regular file for reading.

    A pipe or device is refused at once: it may never end, or make whoever opens it wait for a writer.

    Args:
        path: of the file.
        expected: what should be there, for the message: ``a TUM trajectory``.
        error: the exception to raise.

    Raises:
        InputError: (or ``error``) it cannot be opened, or is no regular file.
    """
    try:
        handle = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except (OSError, ValueError) as problem:  # ValueError: a null byte in the name
        reason = getattr(problem, "strerror", None) or problem
        raise error(f"{reason}, expected {expected}", file=path) from problem
    kind = stat.S_IFMT(os.fstat(handle).st_mode)
    if kind != stat.S_IFREG:
        os.close(handle)
        raise error(f"{_KINDS.get(kind, 'is no regular file')}, expected {expected}", file=path)
    return os.fdopen(handle, "rb")


def read_bytes(
    path: str | PathLike[str], expected: str, *, limit: int, error: type[MoteslamError] = InputError
) -> bytes:
    """The content of a regular file of at most ``limit`` bytes.

    Raises:
        InputError: (or ``error``) it cannot be read, is no regular file, or is larger.
    """
    try:
        with open_regular(path, expected, error=error) as file:
            content = file.read(limit + 1)
    except OSError as problem:
        raise error(f"{problem.strerror or problem}, expected {expected}", file=path) from problem
    if len(content) > limit:
        raise error(f"over {limit / 1e6:g} MB, expected {expected}", file=path)
    return content


def read_text(path: str | PathLike[str], expected: str, *, limit: int, error: type[MoteslamError] = InputError) -> str:
    """The text of a regular UTF-8 file of at most ``limit`` bytes, without a byte order mark.

    Raises:
        InputError: (or ``error``) as ``read_bytes``, or it is not UTF-8.
    """
    content = read_bytes(path, expected, limit=limit, error=error)
    try:
        return content.decode("utf-8-sig")
    except UnicodeDecodeError as problem:
        raise error(f"not UTF-8 text, expected {expected}", file=path) from problem
