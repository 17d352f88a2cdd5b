"""The frames of a bag's ``/tf`` and ``/tf_static``: where sensors stand on the robot, and its odometry.

Frames as in ROS REP 105: ``odom`` moves smoothly under the robot's ``base_link`` or ``base_footprint``, on which the
sensors stand. Names with and without a leading slash are the same.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Table, Topic
from moteslam.robot.formats.bags.messages import SECOND, frame_name
from moteslam.robot.formats.streams import MAX_PLACE
from moteslam.robot.se2 import wrap
from moteslam.robot.trajectory import rotations_of

TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")

BASES = ("base_footprint", "base_link")
"""Frames of a robot, the first that a tree has."""

MAX_FRAMES = 10_000
"""Different pairs of frames that are kept."""

LEVEL, TILTED = math.radians(2.0), math.radians(15.0)
"""A lidar tilted by less counts as level, for transforms are measured by hand; one tilted by more does not scan the
plane that the robot drives in [rad]."""

_MOVES = 1e-3
"""A frame that a later transform puts elsewhere by more than this [m, or of its quaternion] moves."""
_DIGITS = 9

Matrix = NDArray[np.float64]
"""A pose in space [4, 4], homogeneous."""


@dataclass
class _Edge:
    pose: tuple[float, ...]
    static: bool
    count: int = 0
    latest: int = 0
    moves: bool = False
    unset: bool = False  # the quaternion has length 0


@dataclass(frozen=True)
class Mount:
    """Where a lidar stands in the robot's frame [m, rad], and whether its beams turn the other way, seen from above."""

    x: float = 0.0
    y: float = 0.0
    z: float = 0.0
    yaw: float = 0.0
    upside_down: bool = False


class Frames:
    """The transforms of a bag: of a static one the last counts, as in tf2, of another the first.

    Attributes:
        odometry: by parent ``odom*`` and child, its transforms, seven numbers each.
    """

    def __init__(self) -> None:
        self._edges: dict[tuple[str, str], _Edge] = {}
        self.odometry: dict[tuple[str, str], Table] = {}

    def add(self, message: Any, order: int, *, topic: Topic) -> None:
        """A message of a topic, ``tf_static`` or another."""
        static = topic.name.endswith("tf_static")
        for each in message.transforms:
            frames = (frame_name(each.header.frame_id), frame_name(each.child_frame_id))
            place, turn = each.transform.translation, each.transform.rotation
            given = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
            unset = not math.hypot(*given[3:]) > _MOVES
            pose = (*given[:3], 0.0, 0.0, 0.0, 1.0) if unset else given
            edge = self._edges.get(frames)
            if edge is None:
                if len(self._edges) >= MAX_FRAMES:
                    return
                edge = self._edges[frames] = _Edge(pose, static, unset=unset)
                if frames[0].rpartition("/")[2].startswith("odom"):
                    topic_of = Topic(f"/tf {frames[0]} to {frames[1]}", topic.kind)
                    self.odometry[frames] = Table(topic_of, width=7)
            edge.count, edge.latest = edge.count + 1, order
            if pose != edge.pose:
                apart = max(abs(a - b) for a, b in zip(pose, edge.pose, strict=True))
                edge.moves |= not apart <= _MOVES
                if static:
                    edge.pose, edge.static, edge.unset = pose, True, unset
            if (table := self.odometry.get(frames)) is not None:
                stamp = each.header.stamp.sec * SECOND + each.header.stamp.nanosec
                table.flat.extend((stamp, 0, order, 0, 0, 0, 0, hash(given), 0))
                table.numbers.extend(given)

    def __contains__(self, frame: str) -> bool:
        return any(frame in pair for pair in self._edges)

    def base(self) -> str | None:
        """The robot's frame, by its usual names; with a prefix where there are no others."""
        names = dict.fromkeys(name for pair in self._edges for name in pair)
        for base in BASES:
            if base in names:
                return base
            if found := [name for name in names if name.endswith(f"/{base}")]:
                return found[0] if len(found) == 1 else None
        return None

    def odometry_under(self, frame: str) -> tuple[str, Table] | None:
        """The odometry of transforms whose child carries a frame, else that with most; its child and its transforms."""

        def rank(item: tuple[tuple[str, str], Table]) -> tuple[bool, int]:
            (_, child), table = item
            return self.place(frame, child) is not None, len(table)

        best = max(self.odometry.items(), key=rank, default=None)
        return None if best is None else (best[0][1], best[1])

    def place(self, frame: str, base: str | None) -> tuple[Matrix, list[_Edge]] | None:
        """Where a frame stands in another, and the transforms on the way; None where none connect them."""
        if base is None:
            return None
        ours, theirs = self._above(frame), self._above(base)
        shared = base if base in ours else next((name for name in ours if name in theirs), None)
        if shared is None:
            return None
        (pose, way), (other, rest) = ours[shared], theirs[shared]
        return np.linalg.inv(other) @ pose, way + rest

    def _above(self, frame: str) -> dict[str, tuple[Matrix, list[_Edge]]]:
        """The frame and all above it, with its pose in each; of two parents both are gone up to."""
        found: dict[str, tuple[Matrix, list[_Edge]]] = {frame: (np.eye(4), [])}
        waiting = [frame]
        while waiting:
            below = waiting.pop(0)
            parents = [(parent, edge) for (parent, child), edge in self._edges.items() if child == below]
            for parent, edge in sorted(parents, key=lambda one: (-one[1].static, -one[1].count, -one[1].latest)):
                if parent in found or not all(abs(value) <= MAX_PLACE for value in edge.pose):
                    continue
                pose, way = found[below]
                step = np.eye(4)
                step[:3, :3] = rotations_of(np.array([edge.pose[3:]]))[0]
                step[:3, 3] = edge.pose[:3]
                found[parent] = (step @ pose, [*way, edge])
                waiting.append(parent)
        return found

    def lidar_mount(self, bag: Bag, topic: str, frame: str, base: str | None) -> Mount:
        """The mount of the lidar whose scans are in a frame; the robot's centre where no transforms lead there."""
        placed = self.place(frame, base)
        if placed is None:
            what = f"no transform from {base or ' or '.join(BASES)} to {frame or 'its frame'}; the lidar is taken to"
            bag.tell("no-mount", topic, f"{what} stand at the robot's centre")
            return Mount()
        pose, way = placed
        if any(edge.unset for edge in way):
            what = f"a transform to {frame} has a quaternion of length 0; it is taken to turn nothing"
            bag.tell("mount-unturned", topic, what)
        if any(edge.moves and not edge.static for edge in way):
            bag.tell("mount-moves", topic, f"the transforms to {frame} change; the first is taken")
        if any(edge.moves and edge.static for edge in way):
            what = f"a static transform to {frame} was given again, another; the last is taken"
            bag.tell("mount-corrected", topic, what)
        rotation = pose[:3, :3]
        up = float(rotation[2, 2])
        tilt = math.acos(min(1.0, abs(up)))
        if tilt > TILTED:
            problem = f"{frame} is tilted by {math.degrees(tilt):.0f} degrees in {base}, expected a level lidar"
            raise InputError(problem, file=bag.path, field=topic)
        if tilt > LEVEL:
            what = f"{frame} is tilted by {math.degrees(tilt):.1f} degrees; its scans count as level"
            bag.tell("lidar-tilted", topic, what)
        yaw = float(wrap(math.atan2(rotation[1, 0], rotation[0, 0])))
        x, y, z = (round(float(value), _DIGITS) for value in pose[:3, 3])
        return Mount(x, y, z, round(yaw, _DIGITS), upside_down=up < 0)
