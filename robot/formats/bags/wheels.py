"""Wheel counters as joints: ``sensor_msgs/JointState`` has angles that add up, an `EncoderStream` changes of counts.

An angle is counts times the angle of one, ``metres_per_count`` over the wheel's radius. Written angles are sums of
counts, and so the counts come back exactly, as long as they stay below 2^50.
"""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor
from moteslam.robot.formats.bags.heads import enlarged
from moteslam.robot.formats.bags.times import SECOND, used_messages
from moteslam.robot.formats.bounds import SLACK, plausible_counts
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream
from moteslam.robot.wording import counted

JOINTS = ("front_right_wheel_joint", "front_left_wheel_joint", "rear_right_wheel_joint", "rear_left_wheel_joint")
"""As written, in the order of an `EncoderStream`."""

MAX_ANGLE = 1e9
"""No wheel has turned further [rad]: some 30 000 km."""

_STAMP, _FRAME = 4, 12
"""Where stamp and frame of a header begin, in either serialisation."""
_SIDES = ("right", "left")
_REAR = ("rear", "back", "hind")


def angle_of_count(wheels: Wheels) -> float:
    """The angle that a wheel turns for one count [rad]."""
    return wheels.metres_per_count / (wheels.diameter / 2)


def joint_angles(counts: NDArray[np.int64], wheels: Wheels) -> NDArray[np.float64]:
    """The angles [n, 4] [rad] of wheels that stood at 0 before the first of the counts [n, 4]."""
    return np.cumsum(counts, axis=0).astype(np.float64) * angle_of_count(wheels)


class JointReader:
    """Collects the angles of the wheels from messages.

    Args:
        count: of messages.
        ros1: whether they are serialised as in ROS 1.
    """

    def __init__(self, count: int, *, ros1: bool) -> None:
        self._ros1 = ros1
        self._stamps, self._angles, self._count = np.zeros(0, np.int64), np.zeros((0, 4)), 0
        self.grow(count)
        self.seen: tuple[bytes, ...] = ()
        self._columns: tuple[int, ...] | None = None
        self._start, self._front = _FRAME, b""
        self._time, self._numbers = struct.Struct("<II"), struct.Struct("<4d")

    @property
    def stamps(self) -> NDArray[np.int64]:
        """Of the messages [n] [ns]; 0 of a broken one."""
        return self._stamps[: self._count]

    @property
    def angles(self) -> NDArray[np.float64]:
        """Of the wheels [n, 4] [rad]; NaN of a broken message."""
        return self._angles[: self._count]

    def grow(self, count: int) -> None:
        """Make room for a number of messages in all."""
        self._count = count
        if count > len(self._stamps):
            room = max(count, 2 * len(self._stamps))
            self._stamps, self._angles = enlarged(self._stamps, room, 0), enlarged(self._angles, room, np.nan)

    def add(self, index: int, data: bytes) -> None:
        """A message."""
        if data[_FRAME : self._start] != self._front or not self._front:
            try:
                self._remember(data)
            except BrokenMessageError:
                self._front = b""
                return
        if self._columns is None or len(data) < self._start + self._numbers.size:
            return
        sec, nsec = self._time.unpack_from(data, _STAMP)
        self._stamps[index] = sec * SECOND + nsec
        angles = self._numbers.unpack_from(data, self._start)
        self._angles[index] = [angles[column] for column in self._columns]

    def _remember(self, data: bytes) -> None:
        """The names of the joints: those of a bag's messages are the same throughout, or nearly."""
        cursor = Cursor(data, ros1=self._ros1)
        cursor.position = _FRAME
        cursor.raw_text()
        names = tuple(cursor.raw_text() for _ in range(cursor.number("I")))
        self.seen = self.seen or names
        count = cursor.number("I")
        cursor.align(8)
        self._start, self._front = cursor.position, data[_FRAME : cursor.position]
        self._columns = _columns(names) if count == len(names) else None
        self._time, self._numbers = struct.Struct(f"{cursor.order}II"), struct.Struct(f"{cursor.order}{count}d")


def _columns(names: tuple[bytes, ...]) -> tuple[int, ...] | None:
    """Which joints are the front right, front left, rear right and rear left wheel; None where there are no such.

    A wheel is a joint with its side in its name; of two wheels each counts twice.
    """
    columns: dict[tuple[str, bool], int] = {}
    for index, raw in enumerate(names):
        name = raw.decode(errors="replace").lower()
        for side in _SIDES:
            if side in name and ("wheel" in name or len(names) <= 4):
                columns.setdefault((side, any(word in name for word in _REAR)), index)
    order = [(side, rear) for rear in (False, True) for side in _SIDES]
    found = [columns.get((side, rear), columns.get((side, not rear))) for side, rear in order]
    return None if None in found else tuple(index for index in found if index is not None)


def encoder_stream(bag: Bag, topic: Topic, reader: JointReader, wheels: Wheels, issues: list[Issue]) -> EncoderStream:
    """The counters of the wheels.

    The first reading counts from 0 where the wheels had travelled less than 1 m by then, else it counts nothing:
    joints go on from where they stood. No motion is before the first reading in either case.

    Raises:
        InputError: no joints that are wheels, too many broken messages, or absurd stamps.
    """
    angles = reader.angles
    broken = np.asarray(~(np.abs(angles) <= MAX_ANGLE).all(axis=1))
    if broken.all():
        names = ", ".join(name.decode(errors="replace")[:40] for name in reader.seen[:8]) or "none"
        problem = f"joints {names}, expected angles of wheels with left and right in their names"
        raise InputError(problem, file=bag.path, field=topic.name)
    kept, stamps = used_messages(bag.path, topic, reader.stamps, broken, issues)
    totals = np.rint(angles[kept] / angle_of_count(wheels)).astype(np.int64)
    counts = np.diff(totals, axis=0, prepend=0)
    if np.abs(counts[0]).max() * wheels.metres_per_count > SLACK:
        counts[0] = 0
    good = plausible_counts(stamps, counts, wheels.metres_per_count)
    if dropped := int((~good).sum()):
        _drop(bag.path, topic.name, dropped, len(good), issues)
    return EncoderStream(stamps[good], counts[good])


def _drop(path: Path, topic: str, dropped: int, count: int, issues: list[Issue]) -> None:
    if dropped > max(3, count // 10):
        problem = f"{dropped} of {counted(count, 'reading')} beyond 100 m/s, expected wheels of a robot"
        raise InputError(problem, file=path, field=topic)
    text = f"{path.name}: {topic}: {counted(dropped, 'reading')} beyond 100 m/s dropped"
    issues.append(Issue("implausible-readings", text, dropped))
