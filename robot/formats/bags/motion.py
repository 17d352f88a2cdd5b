"""Where sensors stand and how the robot moved: transforms, odometry, inertial readings, wheels as joints.

Frames as in ROS REP 105: ``odom`` moves smoothly under the robot's ``base_link`` or ``base_footprint``, on which the
sensors stand. Names with and without a leading slash are the same.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from operator import attrgetter
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bags.bag import SECOND, Bag, Table
from moteslam.robot.formats.bags.storage import Topic
from moteslam.robot.formats.streams import MAX_PLACE, MAX_RATE, SLACK, Sensors
from moteslam.robot.platform import LidarSpec, Platform, Wheels
from moteslam.robot.recording import EncoderStream, ImuStream, OdometryStream
from moteslam.robot.trajectory import rotations_of
from moteslam.robot.values import counted

TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")
ODOMETRY, IMU, JOINT_STATE = "nav_msgs/Odometry", "sensor_msgs/Imu", "sensor_msgs/JointState"
BASES = ("base_footprint", "base_link")  # Frames of a robot, the first that a tree has
MAX_FRAMES = 10_000  # pairs that are kept
LEVEL, TILTED = math.radians(2.0), math.radians(15.0)
"""A lidar tilted by less counts as level, for transforms are measured by hand; one tilted by more does not scan the
plane that the robot drives in [rad]."""
GRAVITY = 9.80665  # [m/s^2]
MAX_ANGLE = 1e9  # [rad]: no wheel has turned further
REACH, MIN_PATH = 0.2, 1.0  # Of a path, along which a direction is taken, and of one that is long enough to say any [m]
MIN_TURN, FOLLOWS = math.radians(60), 0.3
"""A path that turns by more [rad] and agrees with the headings by less (the mean resultant length of twice the angle
between them, which is 1 for wheels that do not slip) has headings that are none."""
_SIDES, _REAR = ("right", "left"), ("rear", "back", "hind")
_LEVEL = 1e-6
_MOVES, _APART = 1e-3, 0.01
"""A frame that a later transform puts elsewhere by more than the first [m, or of its quaternion] moves; two ways that
lead to one by more than the second [m, or of its axes] differ."""
HOP, HARDEST, MANY_HOPS, SHARE_OF_HOPS = 0.03, 10.0, 10, 0.05
"""Odometry that goes to and fro by more than this [m], [rad], harder than a robot brakes [m/s^2], [rad/s^2], is told of
from so many readings on, and from this share of them on is of two that measure apart."""
_DIGITS = 9


def _numbers(*fields: str) -> Callable[[Any], tuple[float, ...]]:
    """What gives the numbers of some fields of a message: ``orientation.xyzw`` are four."""
    parts = [field.rpartition(".") for field in fields]
    return attrgetter(*(f"{field}.{axis}" for field, _, axes in parts for axis in axes))


_POSE = _numbers("pose.pose.position.xyz", "pose.pose.orientation.xyzw")
RATES = _numbers("angular_velocity.xyz", "linear_acceleration.xyz")
_TRANSFORM = _numbers("transform.translation.xyz", "transform.rotation.xyzw")


def pose_of(message: Any) -> tuple[float, ...]:
    """The pose in a message of odometry, and 1 where a covariance is stated, else 0."""
    return (*_POSE(message), float(np.any(message.pose.covariance)))


@dataclass
class _Edge:
    pose: tuple[float, ...]
    static: bool
    count: int = 0
    moves: bool = False
    unset: bool = False  # the quaternion has length 0


def namespace(topic: str) -> str:
    """The first part of a topic's name, of several: ``a`` of ``/a/scan``."""
    return topic[1:].rpartition("/")[0].partition("/")[0]


class Frames:
    """The transforms of a bag: of a static one the last counts, as in tf2, of another the first.

    Attributes:
        odometry: by namespace, parent ``odom*`` and child, its transforms, seven numbers each.
    """

    def __init__(self, bag: Bag) -> None:
        self.bag = bag
        self._edges: dict[tuple[str, str, str], _Edge] = {}
        self.odometry: dict[tuple[str, str, str], Table] = {}

    def add(self, message: Any, *, topic: Topic) -> tuple[float, ...]:
        """Keep a message of a topic, ``tf_static`` or another."""
        static = topic.name.endswith("tf_static")
        for each in message.transforms:
            pair = (namespace(topic.name), each.header.frame_id.lstrip("/"), each.child_frame_id.lstrip("/"))
            given = _TRANSFORM(each)
            unset = not math.hypot(*given[3:]) > _MOVES
            pose = (*given[:3], 0.0, 0.0, 0.0, 1.0) if unset else given
            edge = self._edges.get(pair)
            if edge is None:
                if len(self._edges) >= MAX_FRAMES:
                    break
                edge = self._edges[pair] = _Edge(pose, static, unset=unset)
                if pair[1].rpartition("/")[2].startswith("odom"):
                    named = topic._replace(name=f"/tf {pair[1]} to {pair[2]}")
                    self.odometry[pair] = Table(named, width=7, frame=pair[1], child=pair[2])
            edge.count += 1
            if pose != edge.pose:
                edge.moves |= not max(abs(a - b) for a, b in zip(pose, edge.pose, strict=True)) <= _MOVES
                if static:
                    edge.pose, edge.static, edge.unset = pose, True, unset
            if (table := self.odometry.get(pair)) is not None:
                stamp = each.header.stamp.sec * SECOND + each.header.stamp.nanosec
                table.flat.extend((stamp, 0, self.bag.swept, 0, 0, 0, 0, hash(given)))
                table.numbers.extend(given)
        return ()

    def keep(self, space: str) -> None:
        """Of several robots' transforms, keep those in a namespace, and those in none."""
        if any(key[0] == space for key in self._edges if space):
            self._edges = {key: edge for key, edge in self._edges.items() if key[0] in (space, "")}
            self.odometry = {key: table for key, table in self.odometry.items() if key in self._edges}

    def __contains__(self, frame: str) -> bool:
        return any(frame in pair for _, *pair in self._edges)

    def base(self) -> str | None:
        """The robot's frame, by its usual names; with a prefix where there are no others."""
        names = dict.fromkeys(name for _, *pair in self._edges for name in pair)
        for base in BASES:
            found = [name for name in names if name == base] or [name for name in names if name.endswith(f"/{base}")]
            if found:
                return found[0] if len(found) == 1 else None
        return None

    def odometry_under(self, frame: str) -> list[Table]:
        """The odometry of transforms whose child carries a frame, else of all, that with most first."""
        tables = sorted(self.odometry.values(), key=len, reverse=True)
        return [table for table in tables if self.place(frame, table.child) is not None] or tables

    def place(self, frame: str, base: str | None) -> tuple[se2.Array, list[_Edge], bool] | None:
        """Where a frame stands in another, the transforms on the way, and whether another way up leads elsewhere; None
        where none connect them.
        """
        if base is None:
            return None
        (ours, apart), (theirs, _) = self._above(frame), self._above(base)
        shared = base if base in ours else next((name for name in ours if name in theirs), None)
        if shared is None:
            return None
        (pose, way), (other, rest) = ours[shared], theirs[shared]
        return np.linalg.inv(other) @ pose, way + rest, shared in apart

    def _above(self, frame: str) -> tuple[dict[str, tuple[se2.Array, list[_Edge]]], set[str]]:
        """The frame and all above it, with its pose in each; of two parents both are gone up to, and those frames are
        named in which it has two poses.
        """
        found: dict[str, tuple[se2.Array, list[_Edge]]] = {frame: (np.eye(4), [])}
        waiting, apart = [frame], set[str]()
        while waiting:
            below = waiting.pop(0)
            parents = [(parent, edge) for (_, parent, child), edge in reversed(self._edges.items()) if child == below]
            for parent, edge in sorted(parents, key=lambda one: (-one[1].static, -one[1].count)):
                if not all(abs(value) <= MAX_PLACE for value in edge.pose):
                    continue
                pose, way = found[below]
                step = np.eye(4)
                step[:3, :3] = rotations_of(np.array([edge.pose[3:]]))[0]
                step[:3, 3] = edge.pose[:3]
                if parent in found:
                    apart |= {parent} if np.abs(step @ pose - found[parent][0]).max() > _APART else set()
                    continue
                found[parent] = (step @ pose, [*way, edge])
                waiting.append(parent)
        return found, apart

    def lidar_mount(self, topic: str, frame: str, base: str | None, *, is_given: bool) -> tuple[LidarSpec, bool]:
        """The mount of the lidar whose scans are in a frame, the robot's centre where no transforms lead there, and
        whether it hangs upside down. What is wrong with it does not matter where it is given.
        """
        placed = self.place(frame, base)
        if placed is None:
            what = f"no transform from {base or ' or '.join(BASES)} to {frame or 'its frame'}; the lidar is taken to"
            if not is_given:
                self.bag.tell("no-mount", topic, f"{what} stand at the robot's centre")
            return LidarSpec(), False
        pose, way, is_apart = placed
        tilt = math.acos(min(1.0, abs(float(pose[2, 2]))))
        if tilt > TILTED and not is_given:
            problem = f"{frame} is tilted by {math.degrees(tilt):.0f} degrees in {base}, expected a level lidar"
            raise InputError(problem, file=self.bag.path, field=topic)
        apart = f"has two parents that put it apart in {base}; the shorter way is taken, to x {pose[0, 3]:.3f}, "
        for code, is_so, what in (
            ("mount-unturned", any(edge.unset for edge in way), "by a quaternion of length 0: taken not to be turned"),
            ("mount-moves", any(edge.moves and not edge.static for edge in way), "changes; the first place is taken"),
            ("mount-corrected", any(edge.moves and edge.static for edge in way), "was given anew; the last is taken"),
            ("mount-moves", is_apart, f"{apart}y {pose[1, 3]:.3f} m"),
            ("lidar-tilted", tilt > LEVEL, f"is tilted by {math.degrees(tilt):.1f} degrees; its scans count as level"),
        ):
            if is_so and not is_given:
                self.bag.tell(code, topic, f"the frame {frame} {what}")
        yaw = float(se2.wrap(math.atan2(pose[1, 0], pose[0, 0])))
        x, y, z = (round(float(value), _DIGITS) for value in pose[:3, 3])
        return LidarSpec.model_construct(x=x, y=y, z=z, yaw=round(yaw, _DIGITS)), bool(pose[2, 2] < 0)


def odometry_stream(bag: Bag, table: Table) -> OdometryStream | None:
    """The odometry of messages or transforms, projected to the plane; None where it says no headings at all."""
    values, topic = table.values, table.topic
    kept, stamps = bag.used(table, np.asarray((np.abs(values) <= MAX_PLACE).all(axis=1)))
    places, turns = values[kept, :2], values[kept, 3:7]
    lengths = np.linalg.norm(turns, axis=1)
    none = lengths == 0
    headings = se2.heading(np.where(none[:, None], (0.0, 0.0, 0.0, 1.0), turns))
    poses, along = np.column_stack((places, headings)), _path_headings(places)
    if (hops := _hops(stamps[~none], poses[~none])) >= MANY_HOPS:
        what = f"to and fro {hops} times, as no robot drives: two nodes publish it in turns, or its stamps are out of "
        unfit = hops >= SHARE_OF_HOPS * len(stamps)
        instead = "goes without it, unless another is named" if unfit else "uses it, as most readings fit"
        bag.tell("odometry-unfit", topic, f"{what}order. SLAM {instead}", hops)
        if unfit:
            return None
    if hops < MANY_HOPS and (problem := _no_headings(lengths, headings, along)):  # else the path shows none
        instead = "the direction of the path is taken, which says nothing of turns on the spot"
        if along is None:
            instead = "the path is too short to take them from: SLAM goes without this odometry"
        bag.tell("no-headings", topic, f"{problem}: {instead}", len(kept))
        return None if along is None else OdometryStream(stamps, np.column_stack((places, along)))
    if count := int(none.sum()):
        bag.tell("broken-messages", topic, f"{counted(count, 'pose')} with a quaternion of length 0 dropped", count)
    return OdometryStream(stamps[~none], poses[~none])


def driven(odometry: OdometryStream | None, began: se2.Array, ended: se2.Array) -> se2.Array:
    """The robot's motions [n, 3] from stamps [n] to others; zeros without odometry."""
    if odometry is None:
        return np.zeros((len(began), 3))
    return se2.between(*(se2.interpolate(odometry.stamps, odometry.poses, at) for at in (began, ended)))


def _hops(stamps: se2.Array, poses: se2.Array) -> int:
    """How often a path [n, 3] leaves a place and is back a reading or two later, faster than a robot can."""
    if len(poses) < 4:
        return 0
    moved = ((poses[k:] - poses[:-k])[: len(poses) - 3] for k in (1, 2, 3))
    step, *back = (np.hypot(one[:, 0], one[:, 1]) + np.abs(se2.wrap(one[:, 2])) for one in moved)
    least = np.maximum(HOP, HARDEST * (stamps[3:] - stamps[:-3]) ** 2 / 16)  # half the time there, half of it braking
    return int(((step > least) & (np.minimum(*back) < step / 2)).sum())


def _no_headings(lengths: se2.Array, headings: se2.Array, along: se2.Array | None) -> str | None:
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


def _path_headings(places: se2.Array) -> se2.Array | None:
    """The directions [n] [rad] in which places [n, 2] follow each other, over twice `REACH` or two steps at least; None
    of a short path.

    A robot that turns by more than 120 degrees on the spot is taken to drive backward from there on.
    """
    travelled = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(places, axis=0).T))))
    before = np.maximum(np.searchsorted(travelled, travelled - REACH) - 1, 0)
    after = np.minimum(np.searchsorted(travelled, travelled + REACH, side="right"), len(places) - 1)
    x, y = (places[after] - places[before]).T
    known = np.flatnonzero(np.hypot(x, y) > REACH / 3)
    if travelled[-1] < MIN_PATH or not len(known):
        return None
    directions = np.unwrap(np.arctan2(y[known], x[known]))
    steps = np.diff(directions, prepend=directions[0])
    reversals = np.cumsum(np.where(np.abs(steps) > 2 * np.pi / 3, np.sign(steps), 0))
    return se2.wrap(np.interp(np.arange(len(places)), known, directions - np.pi * reversals))


def imu_stream(frames: Frames, base: str | None, table: Table) -> ImuStream:
    """The inertial readings in the robot's axes, as far as transforms say how the sensor is turned."""
    values, bag = table.values, frames.bag
    kept, stamps = bag.used(table, np.isfinite(values).all(axis=1) & (np.abs(values[:, :3]).max(axis=1) <= MAX_RATE))
    angular, linear = values[kept, :3], values[kept, 3:] / GRAVITY
    placed = frames.place(table.frame, base)
    rotation = np.eye(3) if placed is None else placed[0][:3, :3]
    if np.abs(rotation - np.eye(3)).max() > _LEVEL:
        angular, linear = angular @ rotation.T, linear @ rotation.T
        what = f"{table.frame} is turned in {base}; its readings are turned into the robot's axes"
        bag.tell("imu-turned", table.topic, what)
    return ImuStream(stamps, angular, linear)


def wheel_angles(message: Any) -> tuple[float, ...]:
    """The angles of the four wheels in a message of joints; a wheel is a joint with its side in its name.

    Of two wheels each counts twice.
    """
    columns: dict[tuple[str, bool], int] = {}
    names = [name.lower() for name in message.name]
    for index, name in enumerate(names):
        for side in _SIDES:
            if side in name and ("wheel" in name or len(names) <= 4):
                columns.setdefault((side, any(word in name for word in _REAR)), index)
    order = [(side, rear) for rear in (False, True) for side in _SIDES]
    found = [columns.get((side, rear), columns.get((side, not rear))) for side, rear in order]
    if None in found or len(message.position) != len(names):
        raise ValueError(f"no wheels with left and right in their names: {', '.join(names)[:200]}")
    return tuple(float(message.position[column]) for column in found)


def encoder_stream(bag: Bag, robot: Platform, table: Table) -> EncoderStream:
    """The counters of the wheels. An angle is counts times that of one, and written angles are sums of counts, which
    come back exactly as long as they stay below 2^50.

    The first reading counts from 0 where the wheels had travelled less than 1 m by then, else it counts nothing:
    joints go on from where they stood. No motion is before the first reading in either case.
    """
    field, wheels = table.topic.name, robot.wheels
    if wheels is None:
        problem = "joints of wheels, expected a platform with [wheels] to count them by"
        raise InputError(problem, file=bag.path, field=field)
    kept, stamps = bag.used(table, np.asarray((np.abs(table.values) <= MAX_ANGLE).all(axis=1)))
    totals = np.rint(table.values[kept] / angle_of_count(wheels)).astype(np.int64)
    counts = np.diff(totals, axis=0, prepend=0)
    if np.abs(counts[0]).max() * wheels.metres_per_count > SLACK:
        counts[0] = 0
    return Sensors(robot, {}, bag.issues).encoders(bag.path, (field, field), stamps, counts)


def angle_of_count(wheels: Wheels) -> float:
    """The angle that a wheel turns for one count [rad]."""
    return wheels.metres_per_count / (wheels.diameter / 2)
