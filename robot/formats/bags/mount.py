"""How a planar lidar stands on the robot: upright, upside down, or tilted, by its frame's pose in the robot's."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from moteslam.errors import InputError
from moteslam.robot.formats.bags.transforms import FrameTree
from moteslam.robot.issues import Issue
from moteslam.robot.se2 import wrap

LEVEL = math.radians(2.0)
"""A lidar tilted by less [rad] counts as level: transforms are measured by hand."""

TILTED = math.radians(15.0)
"""One tilted by more [rad] does not scan the plane that the robot drives in."""

_DIGITS = 9


@dataclass(frozen=True)
class Mount:
    """Where a lidar stands.

    Attributes:
        x, y, z, yaw: in the robot's frame [m, rad].
        upside_down: whether its beams turn the other way, seen from above.
    """

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False


def lidar_mount(path: Path, topic: str, frame: str, tree: FrameTree, base: str | None, issues: list[Issue]) -> Mount:
    """The mount of the lidar whose scans are in a frame; the robot's centre where no transforms lead there.

    Args:
        path, topic: of the scans, for messages.
        frame: of the scans.
        tree: of the bag's transforms.
        base: the robot's frame, where it is known.
        issues: what is not as it should be is added.

    Raises:
        InputError: tilted by more than 15 degrees, from upright and from upside down.
    """
    placed = tree.place(frame, base) if base is not None else None
    if placed is None:
        text = f"{path.name}: {topic}: no transform from {base or BASE_NAMES} to {frame or 'its frame'}"
        issues.append(Issue("no-mount", f"{text}; the lidar is taken to stand at the robot's centre"))
        return Mount()
    if placed.moves:
        text = f"{path.name}: {topic}: the transforms to {frame} change; the first is taken"
        issues.append(Issue("mount-moves", text))
    rotation = placed.pose[:3, :3]
    up = float(rotation[2, 2])
    tilt = math.acos(min(1.0, abs(up)))
    if tilt > TILTED:
        problem = f"{frame} is tilted by {math.degrees(tilt):.0f} degrees in {base}, expected a lidar that lies level"
        raise InputError(problem, file=path, field=topic)
    if tilt > LEVEL:
        text = f"{path.name}: {topic}: {frame} is tilted by {math.degrees(tilt):.1f} degrees; its scans count as level"
        issues.append(Issue("lidar-tilted", text))
    yaw = float(wrap(math.atan2(rotation[1, 0], rotation[0, 0])))
    x, y, z = (round(float(value), _DIGITS) for value in placed.pose[:3, 3])
    return Mount(x, y, z, round(yaw, _DIGITS), upside_down=up < 0)


BASE_NAMES = "base_footprint or base_link"
"""What a robot's frame is called, for messages."""
