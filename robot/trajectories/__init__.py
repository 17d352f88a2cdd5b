"""Files of trajectories, all behind `read_trajectory` and `write_trajectory`."""

from __future__ import annotations

from os import PathLike
from pathlib import Path

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.files import open_regular
from moteslam.robot.formats.bags.files import is_bag
from moteslam.robot.trajectories import bag, g2o, text
from moteslam.robot.trajectories.columns import decoded
from moteslam.robot.trajectories.text import TrajectoryFormat
from moteslam.robot.trajectory import Trajectory

__all__ = [
    "TRAJECTORY_FORMATS",
    "TrajectoryFormat",
    "is_trajectory",
    "read_trajectory",
    "trajectory_format_of",
    "trajectory_format_to_write",
    "write_trajectory",
]

TRAJECTORY_FORMATS = {
    "g2o": g2o.FORMAT,
    "euroc": text.EUROC_FORMAT,
    "tum": text.TUM_FORMAT,
    "kitti": text.KITTI_FORMAT,
}
"""By name, asked in this order."""

HEAD = 1 << 18
"""Bytes of a file that are looked at to know its format."""


def read_trajectory(path: str | PathLike[str]) -> Trajectory:
    """Read a trajectory in any format known here (`TRAJECTORY_FORMATS`): it is known by the content, not by the name.

    Poses are projected to the plane; those in space are kept in ``space``. What was assumed is in ``warnings``: stamps
    that a file does not have, or in another unit; orientations that it does not have. The axes are those of the file;
    `read_kitti` can turn those of a camera.

    Args:
        path: of the file; of a ROS bag ``BAG:TOPIC`` or ``BAG:tf:parent:child``.
    """
    if (parts := bag.parts_of(path)) is not None:
        return bag.read_bag(*parts)
    path = Path(path)
    if is_bag(Path(path)):
        raise InputError(bag.without_topic(path), file=path)
    return trajectory_format_of(path).read(path)


def write_trajectory(path: str | PathLike[str], trajectory: Trajectory, file_format: str | None = None) -> None:
    """Write a trajectory in the format of the name's ending: ``.tum``, ``.kitti``, ``.csv`` (EuRoC) or ``.g2o``.

    ``file_format`` is ``tum``, ``kitti``, ``euroc`` or ``g2o``, whatever the name ends in.
    """
    _, known = trajectory_format_to_write(path, file_format)
    known.write(Path(path), trajectory)


def trajectory_format_to_write(path: str | PathLike[str], name: str | None = None) -> tuple[str, TrajectoryFormat]:
    """The name of a format and the format itself: the one named, or the one that the ending of a path stands for."""
    if name is not None:
        if name not in TRAJECTORY_FORMATS:
            names = ", ".join(sorted(TRAJECTORY_FORMATS))
            raise ConfigError(f"{name!r}, expected one of {names}", field="file_format")
        return name, TRAJECTORY_FORMATS[name]
    for each, known in TRAJECTORY_FORMATS.items():
        if Path(path).name.lower().endswith(known.endings):
            return each, known
    endings = sorted(ending for known in TRAJECTORY_FORMATS.values() for ending in known.endings)
    raise OutputError(f"expected a name that ends in {', '.join(endings)}, or a format", file=path)


def is_trajectory(path: str | PathLike[str]) -> bool:
    """Whether a path is a file whose first lines are those of a trajectory, or one within a bag."""
    if (parts := bag.parts_of(path)) is not None or is_bag(Path(path)):
        return parts is not None
    try:
        trajectory_format_of(path)
    except InputError:
        return False
    return True


def trajectory_format_of(path: str | PathLike[str]) -> TrajectoryFormat:
    """The format of a file, by its comments and its first line that is none."""
    with open_regular(path, "a trajectory") as file:
        head = decoded(file.read(HEAD), "replace")
    comments = ""
    for number, line in enumerate(head.splitlines(), start=1):
        line = line.strip()
        if line.startswith(("#", "%")):
            comments += line + "\n"
        elif line:
            for known in TRAJECTORY_FORMATS.values():
                if known.recognise(comments, line):
                    return known
            names = ", ".join(known.name for known in TRAJECTORY_FORMATS.values())
            raise InputError(f"no line of a trajectory, expected one of {names}", file=path, line=number)
    raise InputError("no poses, expected a trajectory", file=path)
