"""Files that appear together: made in a folder of their own beside the target, and moved to their names at the end."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from os import PathLike
from pathlib import Path

from moteslam.errors import ExistsError, MoteslamError, OutputError
from moteslam.robot.files import folder_for


@contextmanager
def staged_file(
    path: str | PathLike[str], *, force: bool = False, keep: str | PathLike[str] | None = None
) -> Iterator[Path]:
    """A file, with what its format puts beside it, that appears complete when the block ends; nothing where it fails.

    The block writes a file of the same name in a temporary folder, and others beside it. Neither it nor these take the
    place of what is there already, unless ``force``; and those beside it do then only where the file itself is there,
    since else they belong to something else. Folders above are made, and go again where the block fails. The file
    itself is moved last: where it is, the others are.

    Args:
        path: of the file.
        force: replace it.
        keep: an input that must not be replaced.

    Raises:
        ExistsError: the file or one beside it exists.
        OutputError: it is a folder or ``keep``, or cannot be written.
    """
    path = Path(path)
    replaces = _checked(path, force=force, keep=keep)
    with folder_for(path):
        try:
            with tempfile.TemporaryDirectory(prefix=".moteslam-", dir=path.absolute().parent) as place:
                with names_of(place, path.parent):
                    yield Path(place) / path.name
                made = sorted(Path(place).iterdir(), key=lambda file: (file.name == path.name, file.name))
                for file in made[:-1]:
                    _checked(path.with_name(file.name), force=replaces, keep=keep)
                for file in made:
                    file.replace(path.with_name(file.name))
        except OSError as error:
            raise OutputError(f"cannot be written: {error.strerror or error}", file=path) from error


@contextmanager
def names_of(place: str | PathLike[str], target: Path) -> Iterator[None]:
    """Errors about files in a temporary folder, as errors about the folder that they are meant for.

    Raises:
        MoteslamError: those of the block.
    """
    try:
        yield
    except MoteslamError as error:
        if error.file is None or not Path(error.file).is_relative_to(place):
            raise
        file = target / Path(error.file).relative_to(place)
        raise type(error)(error.problem, file=file, field=error.field, line=error.line) from error


def _checked(path: Path, *, force: bool, keep: str | PathLike[str] | None) -> bool:
    """Whether a file is there, which may be replaced.

    Raises:
        ExistsError: it is, and may not.
        OutputError: it is a folder, or what has to be kept.
    """
    if not (path.is_symlink() or path.exists()):
        return False
    if keep is not None and path.exists() and path.samefile(keep):
        raise OutputError("is the input, expected another file", file=path)
    if path.is_dir():
        raise OutputError("is a folder, expected a file", file=path)
    if not force:
        raise ExistsError("exists already; name a new file", file=path)
    return True
