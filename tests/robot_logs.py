"""CARMEN lines for tests."""

import gzip
from collections.abc import Sequence
from pathlib import Path

Pose = Sequence[float]


def flaser(
    ranges: Sequence[float],
    *,
    stamp: float = 1.0,
    logged: float = 0.0,
    robot: Pose = (1.0, 2.0, 0.5),
    laser: Pose | None = None,
) -> str:
    """A FLASER line; the laser stands at the robot's pose unless given."""
    return " ".join(map(str, ["FLASER", len(ranges), *ranges, *(laser or robot), *robot, stamp, "host", logged]))


def robotlaser(
    ranges: Sequence[float],
    *,
    stamp: float = 1.0,
    angle_min: float = -1.5,
    step: float = 0.1,
    limit: float = 80.0,
    remissions: Sequence[float] = (),
    robot: Pose = (1.0, 2.0, 0.5),
) -> str:
    head = ["ROBOTLASER1", 0, angle_min, step * len(ranges), step, limit, 0.01, 0]
    words = [*head, len(ranges), *ranges, len(remissions), *remissions, *robot, *robot, 0, 0, 0, 0, 0]
    return " ".join(map(str, [*words, stamp, "host", 0.0]))


def odom(pose: Pose, stamp: float) -> str:
    return " ".join(map(str, ["ODOM", *pose, 0, 0, 0, stamp, "host", 0.0]))


def write_log(path: Path, lines: Sequence[str], *, packed: bool = False) -> Path:
    """Write lines to a log, gzip if ``packed``; gives the path."""
    data = ("\n".join(lines) + "\n").encode()
    path.write_bytes(gzip.compress(data) if packed else data)
    return path
