"""Files that a file names: in its folder or below, never elsewhere, be it by a link."""

from __future__ import annotations

from pathlib import Path

from moteslam.errors import ConfigError
from moteslam.robot.wording import shortened


def file_within(folder: Path, name: str, *, file: Path, field: str) -> Path:
    """The path of a file that another file names.

    Args:
        folder: of the file that names it, where its name begins; an absolute name may lead there, too.
        name: of the file; it need not be there.
        file: that names it, for messages.
        field: the key that does.

    Raises:
        ConfigError: it lies elsewhere, or is no name.
    """
    try:
        inside = (folder / name).resolve().is_relative_to(folder.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # RuntimeError: links in a circle
        raise ConfigError(f"{shortened(name)}, expected the name of a file", file=file, field=field) from error
    if not inside:
        raise ConfigError(f"{shortened(name)} lies elsewhere, expected a file in {folder}", file=file, field=field)
    return folder / name
