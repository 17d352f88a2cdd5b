"""The formats of recordings there are: the bundled ones, and those of other packages.

Other packages bring theirs as entry points ``moteslam.formats``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Protocol

from moteslam.errors import InputError
from moteslam.plugins import Plugins
from moteslam.robot.platform import Platform
from moteslam.robot.recording import Recording
from moteslam.robot.values import Issue

Robot = Platform | str | PathLike[str] | None
"""A robot, a ``platform.toml`` that overrides the format's own robot, or that one as it is."""

Topics = Mapping[str, tuple[str, ...]]
"""Of which topics of a bag the streams are: ``{"lidar": ("/scan",)}``; several lidars are merged to one."""


@dataclass(frozen=True)
class Format:
    """How a recording is stored.

    Attributes:
        name: what it is called, and how to recognise it.
        is_folder: whether a recording is a folder or a file.
        recognise: whether the content of a path (of that kind) is of this format; must not raise for any other.
        read: ``read(path, sequence, platform)``.
        read_topics: ``read_topics(path, sequence, platform, topics)``, of a format with topics; None for others.
        write: ``write(path, recording)`` writes a file or folder that reads back the same, but for what the format
            cannot hold: an issue each. None for a format that is only read.
        endings: of the names of files in this format, the first the usual one: ``.log``, ``.log.gz``.
    """

    name: str
    is_folder: bool
    recognise: Callable[[Path], bool]
    read: Callable[[Path, str | int | None, Robot], Recording]
    read_topics: Callable[[Path, str | int | None, Robot, Topics], Recording] | None = None
    write: Callable[[Path, Recording], tuple[Issue, ...]] | None = None
    endings: tuple[str, ...] = ()


class ReadsOne(Protocol):
    """Reads the one recording of a file or folder."""

    def __call__(self, path: Path, /, *, platform: Robot) -> Recording:
        """The recording, of the robot that is given or else stated."""


def one_sequence(what: str, read: ReadsOne) -> Callable[[Path, str | int | None, Robot], Recording]:
    """The ``read`` of a `Format` whose files hold one sequence each: it refuses the name of one.

    Args:
        what: such a file, with its article, for the refusal: ``a CARMEN log``.
        read: ``read(path, platform=...)``.
    """

    def read_the_one(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
        if sequence is not None:
            raise InputError(f"{what} is one sequence, expected none to be named", file=path, field="sequence")
        return read(path, platform=platform)

    return read_the_one


FORMATS: Plugins[Format] = Plugins(
    "moteslam.formats",
    Format,
    bundled={
        "ucsd": "moteslam.robot.formats.ucsd:FORMAT",
        "carmen": "moteslam.robot.formats.carmen:FORMAT",
        "csv": "moteslam.robot.formats.csv_log:FORMAT",
        "bag": "moteslam.robot.formats.bags.formats:ROSBAG1",
        "rosbag2": "moteslam.robot.formats.bags.formats:ROSBAG2",
        "mcap": "moteslam.robot.formats.bags.formats:MCAP",
        "db3": "moteslam.robot.formats.bags.formats:DB3",
    },
)
"""By name, asked in this order, those of other packages last."""
