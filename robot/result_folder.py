"""Result folders: made under a temporary name, complete or not there, and replaced only where they are ours."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from os import PathLike
from pathlib import Path

from moteslam.errors import ExistsError, OutputError
from moteslam.robot.files import folder_for
from moteslam.robot.staged import names_of

MARKER = ".moteslam"
"""In every folder that was made here: a line of its own, then the names of the files and folders beside it."""

_TITLE = "made by moteslam"


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
        OutputError: it is not a folder, not ours, holds ``keep`` or the current folder, or cannot be written.
    """
    path = Path(path)
    target = path.absolute()
    _check(path, force=force, keep=keep)
    replaces = target.exists()
    with folder_for(path):
        try:
            with tempfile.TemporaryDirectory(prefix=f".{target.name}.", suffix=".partial", dir=target.parent) as place:
                work = Path(place) / target.name
                work.mkdir()
                with names_of(work, path):
                    yield work
                names = sorted(entry.name for entry in work.iterdir())
                (work / MARKER).write_text("\n".join([_TITLE, *names, ""]), "utf-8")
                _put(work, target, replaces=replaces)
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error


def _put(work: Path, target: Path, *, replaces: bool) -> None:
    """Give a folder its name, in place of the one that was there at the start.

    Raises:
        OutputError: another folder has that name by now; this one is kept beside it.
    """
    old = work.with_name(".replaced")
    if replaces and target.exists() and _foreign(target) is None:
        target.rename(old)
    try:
        if target.exists():
            names = (target.with_name(f"{target.name}-{number}") for number in count(2))
            kept = work.rename(next(name for name in names if not name.exists()))
            raise OutputError(f"appeared in the meantime and is left as it is; the result is in {kept}", file=target)
        work.rename(target)
    finally:
        if old.exists() and not target.exists():
            old.rename(target)


def _check(path: Path, *, force: bool, keep: str | PathLike[str] | None) -> None:
    """Refuse a target that must not be replaced."""
    if not (path.is_symlink() or path.exists()):
        return
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


def _foreign(folder: Path) -> str | None:
    """The first thing in a folder that is not of ours; None where it is empty, or all of it is."""
    names = sorted(entry.name for entry in folder.iterdir())
    try:
        title, *known = (folder / MARKER).read_text("utf-8").splitlines()
    except (OSError, ValueError):
        title, known = "", []
    ours = {MARKER, *known} if title == _TITLE else set()
    return next((name for name in names if name not in ours), None)
