"""The tree of frames that a bag's ``/tf`` and ``/tf_static`` give: where sensors stand on the robot, and its odometry.

Frames as in ROS REP 105: ``odom`` moves smoothly under the robot's ``base_link`` or ``base_footprint``, on which the
sensors stand. Names with and without a leading slash are the same.
"""

from __future__ import annotations

import math
import struct
from array import array
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor
from moteslam.robot.formats.bags.times import SECOND
from moteslam.robot.formats.bounds import MAX_PLACE

BASES = ("base_footprint", "base_link")
"""Frames of a robot, the first that a tree has."""

MAX_FRAMES = 10_000
"""Different pairs of frames that are kept."""

_MOVES = 1e-3
"""A frame that a later transform puts elsewhere by more than this [m, or of its quaternion] moves."""

_STAMP, _FRAMES = 8, 16
"""Where stamp and frames of the first transform begin, in either serialisation."""

Matrix = NDArray[np.float64]
"""A pose in space [4, 4], homogeneous."""


@dataclass(frozen=True, eq=False)
class OdometryEdge:
    """The transforms from an odometry frame to a robot's.

    Attributes:
        parent, child: the frames.
        stamps: [n] [ns], in the order they came.
        poses: [n, 7] x, y, z and the quaternion x, y, z, w.
    """

    parent: str
    child: str
    stamps: NDArray[np.int64]
    poses: NDArray[np.float64]


@dataclass
class _Edge:
    first: tuple[float, ...]
    count: int = 1
    moves: bool = False


class TransformReader:
    """Collects the transforms of ``tf2_msgs/TFMessage`` messages.

    Args:
        ros1: whether they are serialised as in ROS 1.
    """

    def __init__(self, *, ros1: bool) -> None:
        self._ros1 = ros1
        self._stamp = "III" if ros1 else "II"
        self._edges: dict[tuple[bytes, bytes], _Edge] = {}
        self._odometry: dict[tuple[bytes, bytes], tuple[array[int], array[float]]] = {}
        self.broken = 0
        self._size = -1
        self._poses = 0
        self._front = self._names = b""
        self._frames = (b"", b"")
        self._time, self._pose = struct.Struct("<II"), struct.Struct("<7d")

    def add(self, _index: int, data: bytes) -> None:
        """A message."""
        if len(data) == self._size and data[_FRAMES : self._poses] == self._names and data.startswith(self._front):
            sec, nsec = self._time.unpack_from(data, _STAMP)
            self._note(self._frames, sec * SECOND + nsec, self._pose.unpack_from(data, self._poses))
            return
        try:
            cursor = Cursor(data, ros1=self._ros1)
            count = cursor.number("I")
            for _ in range(count):
                sec, nsec = cursor.numbers(self._stamp)[-2:]
                frames = (cursor.raw_text(), cursor.raw_text())
                cursor.align(8)
                poses = cursor.position
                self._note(frames, sec * SECOND + nsec, cursor.numbers("ddddddd"))
        except BrokenMessageError:
            self.broken += 1
            return
        if count == 1:
            self._remember(data, cursor.order, frames, poses)

    def _remember(self, data: bytes, order: str, frames: tuple[bytes, bytes], poses: int) -> None:
        """A message of one transform: most of a bag's, the odometry's, differ from it in numbers alone."""
        self._size, self._frames, self._poses = len(data), frames, poses
        self._front, self._names = data[: 4 if self._ros1 else 8], data[_FRAMES:poses]
        self._time, self._pose = struct.Struct(f"{order}II"), struct.Struct(f"{order}7d")

    def _note(self, frames: tuple[bytes, bytes], stamp: int, pose: tuple[float, ...]) -> None:
        known = self._edges.get(frames)
        if known is None:
            if len(self._edges) >= MAX_FRAMES:
                return
            known = self._edges[frames] = _Edge(pose, 0)
            if frames[0].rpartition(b"/")[2].startswith(b"odom"):
                self._odometry[frames] = (array("q"), array("d"))
        known.count += 1
        if pose != known.first and not known.moves:
            apart = [abs(a - b) for a, b in zip(pose, known.first, strict=True)]
            known.moves = not max(apart) <= _MOVES
        if (rows := self._odometry.get(frames)) is not None:
            rows[0].append(stamp)
            rows[1].extend(pose)

    def tree(self) -> FrameTree:
        """The tree of the frames; of several parents of one, that of most transforms."""
        best: dict[str, tuple[int, str, _Edge]] = {}
        for (parent, child), edge in self._edges.items():
            above, below = frame_name(parent), frame_name(child)
            if below not in best or edge.count > best[below][0]:
                best[below] = (edge.count, above, edge)
        parents = {
            child: (parent, _matrix(edge.first), edge.moves)
            for child, (_, parent, edge) in best.items()
            if math.hypot(*edge.first[3:]) > _MOVES and all(abs(value) <= MAX_PLACE for value in edge.first)
        }
        return FrameTree(parents)

    def odometry(self) -> OdometryEdge | None:
        """The odometry with most transforms, or None."""
        if not self._odometry:
            return None
        (parent, child), (stamps, poses) = max(self._odometry.items(), key=lambda item: len(item[1][0]))
        table = np.array(poses).reshape(-1, 7)
        return OdometryEdge(frame_name(parent), frame_name(child), np.array(stamps, np.int64), table)


@dataclass(frozen=True)
class Placed:
    """Where a frame stands on the robot.

    Attributes:
        pose: in the robot's frame.
        moves: whether a transform on the way there changes; the pose is the first then.
    """

    pose: Matrix
    moves: bool


@dataclass(frozen=True, eq=False)
class FrameTree:
    """Frames with their parents.

    Attributes:
        parents: by frame, its parent, its pose there, and whether that changes.
    """

    parents: dict[str, tuple[str, Matrix, bool]]

    def __contains__(self, frame: str) -> bool:
        return frame in self.parents or any(parent == frame for parent, _, _ in self.parents.values())

    def base(self) -> str | None:
        """The robot's frame, by its usual names."""
        return next((name for name in BASES if name in self), None)

    def place(self, frame: str, base: str) -> Placed | None:
        """Where a frame stands in another; None where no transforms connect them."""
        if frame == base:
            return Placed(np.eye(4), moves=False)
        ours, theirs = self._ancestors(frame), self._ancestors(base)
        shared = next((name for name in ours if name in theirs), None)
        if shared is None:
            return None
        (pose, moves), (other, shakes) = ours[shared], theirs[shared]
        return Placed(np.linalg.inv(other) @ pose, moves or shakes)

    def _ancestors(self, frame: str) -> dict[str, tuple[Matrix, bool]]:
        """The frame and those above it, with its pose in each, and whether that changes."""
        found = {frame: (np.eye(4), False)}
        pose, moves = found[frame]
        while frame in self.parents:
            frame, step, changes = self.parents[frame]
            if frame in found:  # a circle
                break
            pose, moves = step @ pose, moves or changes
            found[frame] = (pose, moves)
        return found


def frame_name(raw: bytes | str) -> str:
    """A frame's name without the leading slash of ROS before 2012."""
    return (raw if isinstance(raw, str) else raw.decode(errors="replace")).lstrip("/")


def _matrix(pose: ArrayLike) -> Matrix:
    """The pose [4, 4] of x, y, z and a quaternion x, y, z, w of any length but 0."""
    values = np.asarray(pose, np.float64)
    x, y, z, w = values[3:] / np.linalg.norm(values[3:])
    matrix = np.eye(4)
    matrix[:3, :3] = (
        (1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)),
        (2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)),
        (2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)),
    )
    matrix[:3, 3] = values[:3]
    return matrix
