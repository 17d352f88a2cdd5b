"""What says how the robot moved: odometry of messages or transforms, inertial readings, wheels as joints."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bags.bag import Bag, Table, Topic
from moteslam.robot.formats.bags.frames import BASES, Frames
from moteslam.robot.formats.streams import MAX_PLACE, SLACK, keep_plausible, plausible_counts, plausible_rates
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, ImuStream, OdometryStream
from moteslam.robot.values import Issue, counted

ODOMETRY, IMU, JOINT_STATE = "nav_msgs/Odometry", "sensor_msgs/Imu", "sensor_msgs/JointState"

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""

MAX_ANGLE = 1e9
"""No wheel has turned further [rad]: some 30 000 km."""

REACH, MIN_PATH = 0.2, 1.0
"""Of a path, along which a direction is taken, and of one that is long enough to say any [m]."""
MIN_TURN, FOLLOWS = math.radians(60), 0.3
"""A path that turns by more [rad] and agrees with the headings by less (the mean resultant length of twice the angle
between them, which is 1 for wheels that do not slip) has headings that are none."""

_TRUTH = re.compile(r"(^|[^a-z])(ground_?truth|groundtruth|truth|true|gt|p3d)([^a-z]|$)")
"""In the name of a topic or frame that holds where the robot truly was."""
_WORLD = {"world", "map"}
"""Frames in which no wheel measures."""
_SIDES, _REAR = ("right", "left"), ("rear", "back", "hind")
_LEVEL = 1e-6


def pose_of(message: Any) -> tuple[float, ...]:
    """Position and quaternion of an odometry message."""
    place, turn = message.pose.pose.position, message.pose.pose.orientation
    pose = (place.x, place.y, place.z, turn.x, turn.y, turn.z, turn.w)
    if not all(abs(value) <= MAX_PLACE for value in pose):
        raise ValueError("no pose of a robot")
    return pose


def rates_of(message: Any) -> tuple[float, ...]:
    """Rates and accelerations of an inertial message."""
    turn, push = message.angular_velocity, message.linear_acceleration
    values = (turn.x, turn.y, turn.z, push.x, push.y, push.z)
    if not all(map(math.isfinite, values)):
        raise ValueError("no reading")
    return values


def choose_odometry(bag: Bag, tables: Sequence[Table], lidar: tuple[str, str], frames: Frames) -> Table | None:
    """The odometry where none is named: of the robot of the lidar's topic and frame, never where it truly was.

    ``tables`` are of all odometry of the bag, those with most messages first.
    """
    topic, frame = lidar

    def is_truth(table: Table) -> bool:
        parent = table.frame().rpartition("/")[2].lower()
        named = (table.topic.name.lower(), table.frame().lower(), table.child.lower())
        return parent in _WORLD or any(map(_TRUTH.search, named))

    def is_other_robots(table: Table) -> bool:
        apart = table.child in frames and frame in frames and frames.place(frame, table.child) is None
        return apart and not (table.child in BASES and any(frames.place(frame, base) for base in BASES))

    def rank(table: Table) -> tuple[bool, bool, bool, int]:
        is_odom = table.frame().rpartition("/")[2].startswith("odom")
        carries = frames.place(frame, table.child) is not None
        return carries, beside(table.topic.name, topic), is_odom, len(table)

    truth = [table for table in tables if is_truth(table)]
    others = [table for table in tables if table not in truth and is_other_robots(table)]
    if truth:
        names = ", ".join(f"{table.topic.name} (in {table.frame() or 'no frame'})" for table in truth[:4])
        what = "where the robot truly was, or an estimate in a map; not used as odometry unless it is named"
        bag.tell("truth-left", names, what, len(truth))
    if others:
        names = ", ".join(table.topic.name for table in others[:4])
        what = f"of a robot that does not carry the lidar's frame {frame}; left aside"
        bag.tell("other-robot", names, what, len(others))
    candidates = [table for table in tables if table not in truth and table not in others]
    best = max(candidates, key=rank, default=None)
    if best is not None:
        left_aside(bag, "odometry", best.topic, [table.topic for table in candidates if table is not best])
    return best


def beside(topic: str, lidar: str) -> bool:
    """Whether a topic is in the namespace of the lidar's, or one of the two is in none."""
    ours, theirs = topic.split("/")[1:-1], lidar.split("/")[1:-1]
    return not ours or not theirs or ours[0] == theirs[0]


def odometry_stream(bag: Bag, table: Table) -> OdometryStream | None:
    """The odometry of messages or transforms, projected to the plane; None where it says no headings at all."""
    values, topic = table.values, table.topic
    kept, stamps = bag.used(table, np.asarray((np.abs(values) <= MAX_PLACE).all(axis=1)))
    places, turns = values[kept, :2], values[kept, 3:]
    lengths = np.linalg.norm(turns, axis=1)
    none = lengths == 0
    headings = se2.heading(np.where(none[:, None], (0.0, 0.0, 0.0, 1.0), turns))
    along = _path_headings(places)
    if problem := _no_headings(lengths, headings, along):
        if along is None:
            what = f"{problem}, and a path too short to take them from: SLAM goes without this odometry"
            bag.tell("no-headings", topic, what, len(kept))
            return None
        what = f"{problem}: the direction of the path is taken, which says nothing of turns on the spot"
        bag.tell("no-headings", topic, what, len(kept))
        return OdometryStream(stamps, np.column_stack((places, along)))
    if none.any():
        count = int(none.sum())
        bag.tell("broken-messages", topic, f"{counted(count, 'pose')} with a quaternion of length 0 dropped", count)
    return OdometryStream(stamps[~none], np.column_stack((places, headings))[~none])


def _no_headings(
    lengths: NDArray[np.float64], headings: NDArray[np.float64], along: NDArray[np.float64] | None
) -> str | None:
    """Why quaternions of some lengths [n], as headings [n], say no headings beside those along the path; else None."""
    many = 0.1 * len(lengths)
    if (zero := int((lengths == 0).sum())) > many:
        return f"{zero} of {len(lengths)} quaternions of length 0"
    if (short := int((np.abs(lengths - 1) > 0.1).sum())) > many:
        return f"{short} of {len(lengths)} quaternions of lengths {lengths.min():.2g} to {lengths.max():.2g}, not 1"
    if along is None or np.ptp(np.unwrap(along)) < MIN_TURN:
        return None
    if np.ptp(np.unwrap(headings)) < _LEVEL:
        return f"every heading is {math.degrees(headings[0]):.1f} degrees while the path turns"
    off = np.abs(np.exp(2j * (along - headings)).mean())  # twice: forward and backward are one direction
    return f"headings that do not follow the path (agreement {off:.2f} of 1)" if off < FOLLOWS else None


def _path_headings(places: NDArray[np.float64]) -> NDArray[np.float64] | None:
    """The directions [n] [rad] in which places [n, 2] follow each other, over twice `REACH`; None of a short path.

    A robot that turns by more than 120 degrees on the spot is taken to drive backward from there on.
    """
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))))
    before = np.searchsorted(travelled, travelled - REACH)
    after = np.searchsorted(travelled, travelled + REACH, side="right") - 1
    x, y = (places[after] - places[before]).T
    known = np.flatnonzero(np.hypot(x, y) > REACH / 3)
    if travelled[-1] < MIN_PATH or not len(known):
        return None
    directions = np.unwrap(np.arctan2(y[known], x[known]))
    steps = np.diff(directions, prepend=directions[0])
    reversals = np.cumsum(np.where(np.abs(steps) > 2 * np.pi / 3, np.sign(steps), 0))
    return se2.wrap(np.interp(np.arange(len(places)), known, directions - np.pi * reversals))


def imu_stream(bag: Bag, table: Table, frames: Frames, base: str | None) -> ImuStream:
    """The inertial readings in the robot's axes, as far as transforms say how the sensor is turned."""
    values = table.values
    kept, stamps = bag.used(table, plausible_rates(values[:, :3]))
    angular, linear = values[kept, :3], values[kept, 3:] / GRAVITY
    frame = table.frame()
    placed = frames.place(frame, base)
    rotation = np.eye(3) if placed is None else placed[0][:3, :3]
    if np.abs(rotation - np.eye(3)).max() > _LEVEL:
        angular, linear = angular @ rotation.T, linear @ rotation.T
        turn = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(rotation)) - 1) / 2))))
        what = f"{frame} is turned by {turn:.1f} degrees in {base}; its readings are turned into the robot's axes"
        bag.tell("imu-turned", table.topic, what)
    return ImuStream(stamps, angular, linear)


def left_aside(bag: Bag, what: str, used: Topic, others: list[Topic]) -> None:
    """An issue that names the topics of a kind that are not used, if there are any."""
    if others:
        names = ", ".join(f"{topic.name} ({counted(topic.count, 'message')})" for topic in others[:8])
        used_ones = f"{what} of {used.name} ({counted(used.count, 'message')}) used"
        bag.issues.append(Issue("topics-left", f"{bag.path.name}: {used_ones}; left aside: {names}", len(others)))


class Joints:
    """The angles of the wheels in messages of joints; a wheel is a joint with its side in its name.

    Of two wheels each counts twice. An angle is counts times the angle of one, ``metres_per_count`` over the wheel's
    radius; written angles are sums of counts, and so the counts come back exactly, as long as they stay below 2^50.
    """

    def __init__(self) -> None:
        self._columns: dict[tuple[str, ...], list[int]] = {}

    def __call__(self, message: Any) -> tuple[float, ...]:
        """The angles of the four wheels in a message; a ValueError where it has none."""
        names = tuple(message.name)
        if names not in self._columns and len(self._columns) < 100:
            self._columns[names] = _wheel_columns(names)
        columns = self._columns.get(names)
        if not columns or len(message.position) != len(names):
            raise ValueError("no wheels")
        angles = tuple(float(message.position[column]) for column in columns)
        if not all(abs(angle) <= MAX_ANGLE for angle in angles):
            raise ValueError("no angles")
        return angles

    def encoder_stream(self, bag: Bag, table: Table, wheels: Wheels) -> EncoderStream:
        """The counters of the wheels.

        The first reading counts from 0 where the wheels had travelled less than 1 m by then, else it counts nothing:
        joints go on from where they stood. No motion is before the first reading in either case.
        """
        name = table.topic.name
        if not len(table):
            names = ", ".join(joint[:40] for joint in next(iter(self._columns), ())[:8]) or "none"
            problem = f"joints {names}, expected angles of wheels with left and right in their names"
            raise InputError(problem, file=bag.path, field=name)
        kept, stamps = bag.used(table)
        totals = np.rint(table.values[kept] / angle_of_count(wheels)).astype(np.int64)
        counts = np.diff(totals, axis=0, prepend=0)
        if np.abs(counts[0]).max() * wheels.metres_per_count > SLACK:
            counts[0] = 0
        plausible = plausible_counts(stamps, counts, wheels.metres_per_count)
        return EncoderStream(*keep_plausible(bag.path, name, plausible, "beyond 100 m/s", bag.issues, stamps, counts))


def _wheel_columns(names: tuple[str, ...]) -> list[int]:
    """Which joints are the front right, front left, rear right, rear left wheel; none where one is not there."""
    columns: dict[tuple[str, bool], int] = {}
    for index, name in enumerate(map(str.lower, names)):
        for side in _SIDES:
            if side in name and ("wheel" in name or len(names) <= 4):
                columns.setdefault((side, any(word in name for word in _REAR)), index)
    order = [(side, rear) for rear in (False, True) for side in _SIDES]
    found = [columns.get((side, rear), columns.get((side, not rear))) for side, rear in order]
    return [] if None in found else [index for index in found if index is not None]


def angle_of_count(wheels: Wheels) -> float:
    """The angle that a wheel turns for one count [rad]."""
    return wheels.metres_per_count / (wheels.diameter / 2)
