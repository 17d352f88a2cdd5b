"""Writing files so that nothing is ever half written: a temporary name beside the target, then a rename."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import IO

from moteslam.errors import OutputError


def write_atomically(path: str | PathLike[str], content: str | bytes | Callable[[IO[bytes]], None]) -> None:
    """Write a complete file, or none.

    Args:
        path: the target; its folder must exist.
        content: text (UTF-8), bytes, or a function that writes into the open binary file.

    Raises:
        OutputError: the folder is missing or read-only, the disk is full, or the target is there and no regular file.
            Nothing is left behind.
    """
    path = Path(path)
    temporary = None
    try:
        expect_file(path)
        handle, temporary = tempfile.mkstemp(prefix=".moteslam-", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        Path(temporary).chmod(0o666 & ~umask())
        Path(temporary).replace(path)
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
    finally:
        if temporary is not None:
            Path(temporary).unlink(missing_ok=True)


@contextmanager
def folder_for(path: str | PathLike[str]) -> Iterator[None]:
    """Make the folders above a file that the block will write; where it fails, those that were made go again.

    Raises:
        OutputError: they cannot be made.
    """
    path = Path(path)
    made = [folder for folder in path.absolute().parents if not folder.exists()]
    done = False
    try:
        _make_parents(path)
        yield
        done = True
    finally:
        for folder in () if done else made:
            with suppress(OSError):  # not there, or no longer ours alone
                folder.rmdir()


def make_folder(folder: str | PathLike[str]) -> None:
    """Make a folder and those above it, unless it is there.

    Raises:
        OutputError: it cannot be made.
    """
    try:
        Path(folder).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(f"cannot be made: {error.strerror or error}", file=folder) from error


def _make_parents(path: Path) -> None:
    target = path.absolute()
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        above = next((parent for parent in target.parents if parent.exists()), target.parent)
        if not above.is_dir():
            shown = next((parent for parent in path.parents if parent.absolute() == above), above)
            raise OutputError(f"cannot be made: {shown} is a file, expected a folder", file=path) from error
        raise OutputError(f"cannot be made: {error.strerror or error}", file=path) from error


def expect_file(path: Path) -> None:
    """Refuse what a rename would take the place of, or fail at: a folder, a device, a pipe.

    Raises:
        OutputError: the path is one of these.
    """
    if path.is_dir():
        raise OutputError("cannot be written: it is a folder, expected the name of a file", file=path)
    if path.exists() and not path.is_file():
        raise OutputError("cannot be written: it is no regular file, expected the name of a new file", file=path)


def umask() -> int:
    """The permissions that files of this process do without."""
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
