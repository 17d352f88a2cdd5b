"""Result folders: made under a temporary name, complete or not there, and replaced only where they are ours.

While a folder is made its run holds a lock on the marker in it, so that another run into the same place knows it from
one that a killed run left behind.
"""

from __future__ import annotations

import os
import re
import secrets
import shutil
import sys
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from itertools import count
from os import PathLike
from pathlib import Path
from typing import IO

from moteslam.errors import ExistsError, MoteslamWarning, OutputError
from moteslam.robot.files import folder_for, umask
from moteslam.robot.staged import names_of

MARKER = ".moteslam"
"""In every folder that was made here: a line of its own, then the names of the files and folders beside it."""

_TITLE = "made by moteslam"
_BUSY = "another run is writing to it, expected another folder"


@contextmanager
def result_folder(
    path: str | PathLike[str], *, force: bool = False, keep: str | PathLike[str] | None = None
) -> Iterator[Path]:
    """A new folder that appears under its name, complete, when the block ends, and not at all when it fails.

    The block writes into a temporary sibling. An existing folder is refused unless ``force``, and then replaced at the
    end if it is empty or holds nothing but what moteslam wrote; an interrupt or error leaves it as it was. Folders
    above it are made, and go again likewise. A folder that appears in the meantime is left alone: the result is then
    kept beside it.

    Args:
        path: of the folder.
        force: replace what is there.
        keep: an input that must not be replaced along with it.

    Raises:
        ExistsError: the target exists, without ``force``.
        OutputError: it is not a folder, not ours, holds ``keep`` or the current folder, cannot be written, or another
            run is writing to it.
    """
    path = Path(path)
    target = path.absolute()
    if _others(target):
        raise OutputError(_BUSY, file=path)
    replaced = _checked(path, force=force, keep=keep)
    with folder_for(path):
        try:
            work = _Work.begin(target)
        except OSError as error:
            raise OutputError(f"cannot be made: {error.strerror or error}", file=path) from error
        try:
            if any(other.name < work.folder.name for other in _others(target)):
                raise OutputError(_BUSY, file=path)
            try:
                with names_of(work.folder, path):
                    yield work.folder
                work.finish(target, replaced)
            except OSError as error:
                raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error
        finally:
            work.close(target)


def _checked(path: Path, *, force: bool, keep: str | PathLike[str] | None) -> os.stat_result | None:
    """Refuse a target that must not be replaced; its status where it is there."""
    if not (path.is_symlink() or path.exists()):
        return None
    if not force:
        raise ExistsError("exists already; name a new folder", file=path)
    if path.is_symlink() or not path.is_dir():
        raise OutputError("is not a folder, expected a folder to replace", file=path)
    for what, inside in (("the current folder", Path.cwd()), ("the input", keep)):
        if inside is not None and Path(inside).resolve().is_relative_to(path.resolve()):
            raise OutputError(f"holds {what}, which would be deleted; expected another folder", file=path)
    try:
        foreign = _foreign(path)
    except OSError as error:
        raise OutputError(f"cannot be read: {error.strerror or error}", file=path) from error
    if foreign is not None:
        raise OutputError(f"holds {foreign}, which moteslam did not write; expected another folder", file=path)
    return path.stat()


def _foreign(folder: Path) -> str | None:
    """The first thing in a folder that is not of ours; None where it is empty, or all of it is."""
    names = sorted(entry.name for entry in folder.iterdir())
    try:
        title, *known = (folder / MARKER).read_text("utf-8").splitlines()
    except (OSError, ValueError):
        title, known = "", []
    ours = {MARKER, *known} if title == _TITLE else set()
    return next((name for name in names if name not in ours), None)


@dataclass
class _Work:
    """The folder that a result is made in, with the lock on its marker.

    Attributes:
        folder: a sibling of the target.
        marker: open, and locked while the run lasts.
    """

    folder: Path
    marker: IO[str]

    @classmethod
    def begin(cls, target: Path) -> _Work:
        """Make one beside a target, under a name that sorts by the time it was made."""
        while True:
            name = f".{target.name}.{time.time_ns():016x}-{secrets.token_hex(4)}.partial"
            folder = target.with_name(name)
            folder.mkdir(mode=0o700)
            try:
                marker = (folder / MARKER).open("x", encoding="utf-8")
            except FileNotFoundError:  # another run took it for one that was left behind
                continue
            if take_lock(marker.fileno()) is not False and (folder / MARKER).exists():
                folder.chmod(0o777 & ~umask())
                return cls(folder, marker)
            marker.close()

    def finish(self, target: Path, replaced: os.stat_result | None) -> None:
        """Give the folder its name, in place of the one that was there at the start.

        Raises:
            OutputError: another folder has that name by now; this one is kept beside it.
        """
        self.marker.write(
            "\n".join([_TITLE, *sorted(p.name for p in self.folder.iterdir() if p.name != MARKER)]) + "\n"
        )
        self.marker.flush()
        if target.exists():
            same = replaced is not None and os.path.samestat(replaced, target.stat())
            if same and _foreign(target) is None:
                target.rename(self._old)
        if not _renamed(self.folder, target):
            kept = next(name for n in count(2) if _renamed(self.folder, name := target.with_name(f"{target.name}-{n}")))
            raise OutputError(f"appeared in the meantime and is left as it is; the result is in {kept}", file=target)

    def close(self, target: Path) -> None:
        """Let go of the lock; delete what was replaced, or what was made and not finished."""
        if self._old.exists():
            with suppress(OSError):  # stopped between the renames: at most an empty folder stands there
                target.rmdir()
            if not target.exists():
                self._old.rename(target)
            shutil.rmtree(self._old, ignore_errors=True)
        shutil.rmtree(self.folder, ignore_errors=True)
        with suppress(OSError):
            self.marker.close()

    @property
    def _old(self) -> Path:
        return self.folder.with_suffix(".old")


def _renamed(folder: Path, target: Path) -> bool:
    """Rename a folder if nothing has that name, as one step."""
    try:
        target.mkdir()  # whoever makes it has it: renaming puts the folder in place of an empty one
        if sys.platform == "win32":
            target.rmdir()
        folder.rename(target)
    except FileExistsError:
        return False
    except OSError:
        if not target.is_dir() or not any(target.iterdir()):
            raise
        return False  # somebody has put something into it
    return True


def _others(target: Path) -> list[Path]:
    """The folders in which other runs are making the same target; what killed runs left behind is cleared away."""
    pattern = re.compile(rf"\.{re.escape(target.name)}\.[0-9a-f]{{16}}-[0-9a-f]{{8}}\.(partial|old)")
    try:
        found = [entry for entry in target.parent.iterdir() if pattern.fullmatch(entry.name)]
    except OSError:
        return []
    alive = []
    for entry in sorted(found, key=lambda entry: entry.suffix):  # .old before .partial, which says if it is in use
        if entry.suffix == ".old":
            _clear_old(entry, target)
        elif _is_alive(entry):
            alive.append(entry)
        else:
            _clear(entry)
    return alive


def _is_alive(partial: Path) -> bool:
    """Whether the run that makes a folder is still alive: it holds the lock, or nobody can know."""
    try:
        with (partial / MARKER).open("r+", encoding="utf-8") as marker:
            return take_lock(marker.fileno()) is not True
    except FileNotFoundError:  # not yet locked, or of a run that was killed before it could be
        return False
    except OSError:
        return True


def take_lock(handle: int) -> bool | None:
    """Take the lock of an open file: whether it was free, or None where there are no locks."""
    try:
        import fcntl
    except ImportError:
        return None
    try:
        fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    except OSError:  # a file system without them
        return None
    return True


def _clear(partial: Path) -> None:
    """Delete what a killed run left behind; an empty folder may be one of a run that begins, which makes another."""
    if not (partial / MARKER).exists():
        with suppress(OSError):
            partial.rmdir()
        return
    shutil.rmtree(partial, ignore_errors=True)
    warnings.warn(MoteslamWarning(f"{partial}: left behind by a run that was killed; deleted"), stacklevel=4)


def _clear_old(old: Path, target: Path) -> None:
    """Put back what a run was about to replace when it was killed, or delete what it had replaced."""
    if _is_alive(old.with_suffix(".partial")):
        return
    if target.exists():
        shutil.rmtree(old, ignore_errors=True)
    else:
        old.rename(target)
        warnings.warn(MoteslamWarning(f"{target}: was being replaced when a run was killed; put back"), stacklevel=4)
