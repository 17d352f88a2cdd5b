"""The formats of recordings there are: the bundled ones, and those of other packages.

Other packages bring theirs as entry points ``moteslam.formats``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from os import PathLike
from pathlib import Path

from moteslam.plugins import Plugins
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording

Robot = Platform | str | PathLike[str] | None
"""A robot, a ``platform.toml`` that overrides the format's own robot, or that one as it is."""


@dataclass(frozen=True)
class Format:
    """How a recording is stored.

    Attributes:
        name: what it is called, and how to recognise it.
        is_folder: whether a recording is a folder or a file.
        recognise: whether the content of a path (of that kind) is of this format; must not raise for any other.
        read: ``read(path, sequence, platform)``.
    """

    name: str
    is_folder: bool
    recognise: Callable[[Path], bool]
    read: Callable[[Path, str | int | None, Robot], Recording]


FORMATS: Plugins[Format] = Plugins(
    "moteslam.formats",
    Format,
    bundled={"ucsd": "moteslam.robot.formats.ucsd:FORMAT", "carmen": "moteslam.robot.formats.carmen:FORMAT"},
)
"""By name, asked in this order, those of other packages last."""
