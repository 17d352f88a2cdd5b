"""Writing files so that nothing is ever half written: a temporary name beside the target, then a rename."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from os import PathLike
from pathlib import Path
from typing import IO

from moteslam.errors import ExistsError, OutputError


def write_atomically(path: str | PathLike[str], content: str | bytes | Callable[[IO[bytes]], None]) -> None:
    """Write a complete file, or none.

    Args:
        path: the target; its folder must exist.
        content: text (UTF-8), bytes, or a function that writes into the open binary file.

    Raises:
        OutputError: the folder is missing or read-only, or the disk is full. Nothing is left behind.
    """
    path = Path(path)
    temporary = None
    try:
        handle, temporary = tempfile.mkstemp(prefix=".moteslam-", dir=path.parent)
        with os.fdopen(handle, "wb") as file:
            if callable(content):
                content(file)
            else:
                file.write(content.encode() if isinstance(content, str) else content)
        Path(temporary).chmod(0o666 & ~_umask())
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


@contextmanager
def result_folder(
    path: str | PathLike[str], *, force: bool = False, keep: str | PathLike[str] | None = None
) -> Iterator[Path]:
    """A new folder that appears under its name, complete, when the block ends, and not at all when it fails.

    The block writes into a temporary sibling. An existing folder is refused unless ``force``, and then replaced
    at the end; an interrupt or error leaves it as it was. Folders above it are made, and go again likewise.

    Args:
        path: of the folder.
        force: replace what is there.
        keep: an input that must not be replaced along with it.

    Raises:
        ExistsError: the target exists, without ``force``.
        OutputError: it is not a folder, holds ``keep`` or the current folder, or cannot be written.
    """
    path = Path(path)
    if path.is_symlink() or path.exists():
        if not force:
            raise ExistsError("exists already; name a new folder", file=path)
        if path.is_symlink() or not path.is_dir():
            raise OutputError("is not a folder, expected a folder to replace", file=path)
        for what, inside in (("the current folder", Path.cwd()), ("the input", keep)):
            if inside is not None and Path(inside).resolve().is_relative_to(path.resolve()):
                raise OutputError(f"holds {what}, which would be deleted; expected another folder", file=path)
    with folder_for(path):
        target = path.absolute()
        try:
            work = Path(tempfile.mkdtemp(prefix=f".{target.name}.", suffix=".partial", dir=target.parent))
        except OSError as error:
            raise OutputError(f"cannot be made: {error.strerror or error}", file=path) from error
        old = work.with_suffix(".old")
        try:
            try:
                work.chmod(0o777 & ~_umask())
                yield work
                if target.exists():
                    target.rename(old)
                work.rename(target)
            except OSError as error:
                raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
            except OutputError as error:  # name the folder that was asked for, not the one it is built in
                if error.file is None or not Path(error.file).is_relative_to(work):
                    raise
                raise OutputError(error.problem, file=path / Path(error.file).relative_to(work)) from error
        finally:
            if old.exists() and not target.exists():  # stopped between the two renames
                old.rename(target)
            for left in (work, old):
                shutil.rmtree(left, ignore_errors=True)


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


def _umask() -> int:
    mask = os.umask(0o022)
    os.umask(mask)
    return mask
