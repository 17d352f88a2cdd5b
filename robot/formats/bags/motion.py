"""What says how the robot moved: odometry of messages or transforms, inertial readings, wheels as joints."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.heads import HeadReader, Heads
from moteslam.robot.formats.bags.times import seconds, used_messages
from moteslam.robot.formats.bags.transforms import FrameTree, OdometryEdge, frame_name
from moteslam.robot.formats.bounds import MAX_PLACE, plausible_rates
from moteslam.robot.formats.stamps import stamp_order
from moteslam.robot.issues import Issue
from moteslam.robot.recording import ImuStream, OdometryStream
from moteslam.robot.wording import counted

ODOMETRY, IMU = "nav_msgs/Odometry", "sensor_msgs/Imu"

GRAVITY = 9.80665
"""Standard gravity [m/s^2]."""

_KEPT = (13, 14, 15, 25, 26, 27)
"""Of the float64 behind the header of an Imu: orientation 4, its covariance 9, rates 3, theirs 9, accelerations 3."""
_ANGULAR, _LINEAR = slice(0, 3), slice(3, 6)
_LEVEL = 1e-6


def odometry_reader(topic: Topic, *, ros1: bool) -> HeadReader:
    """What reads the heads of odometry: two frames, a position and a quaternion."""
    return HeadReader(len(topic), ros1=ros1, texts=2, kind="f8", width=7)


def imu_reader(topic: Topic, *, ros1: bool) -> HeadReader:
    """What reads the heads of inertial readings: a frame, and of the 37 numbers behind it rates and accelerations."""
    return HeadReader(len(topic), ros1=ros1, texts=1, kind="f8", width=37, columns=_KEPT)


def child_frame(heads: Heads) -> str:
    """The frame of the robot in odometry messages: that of the first whole one."""
    return next((frame_name(texts[1]) for texts in heads.texts if texts), "")


def odometry_of_messages(bag: Bag, topic: Topic, heads: Heads, issues: list[Issue]) -> OdometryStream:
    """The odometry of messages, projected to the plane.

    Raises:
        InputError: too many broken messages, or absurd stamps.
    """
    kept, stamps = used_messages(bag.path, topic, heads.stamps, heads.broken | _no_poses(heads.values), issues)
    return OdometryStream(stamps, _planar(heads.values[kept]))


def odometry_of_transforms(path: Path, edge: OdometryEdge, issues: list[Issue]) -> OdometryStream | None:
    """The odometry of a bag that has it as transforms only; None where these are no poses.

    Raises:
        InputError: absurd stamps.
    """
    good = ~_no_poses(edge.poses)
    if not good.any():
        return None
    stamps = seconds(edge.stamps[good])
    order, found = stamp_order(stamps, file=path, field=f"/tf {edge.parent} to {edge.child}")
    issues.extend(found)
    poses = _planar(edge.poses[good])
    return OdometryStream(stamps, poses) if order is None else OdometryStream(stamps[order], poses[order])


def _no_poses(values: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which rows [n, 7] are no poses of a robot: not finite, farther than any drives, or a quaternion of no length."""
    far = ~(np.abs(values) <= MAX_PLACE).all(axis=1)
    return np.asarray(far | ~(values[:, 3:] != 0).any(axis=1))


def _planar(values: NDArray[np.float64]) -> se2.Poses:
    return np.column_stack((values[:, :2], se2.heading(values[:, 3:])))


def imu_stream(
    bag: Bag, topic: Topic, heads: Heads, tree: FrameTree, base: str | None, issues: list[Issue]
) -> ImuStream:
    """The inertial readings in the robot's axes, as far as transforms say how the sensor is turned.

    Raises:
        InputError: too many broken messages, or absurd stamps.
    """
    values = heads.values
    bad = ~np.isfinite(values[:, _ANGULAR]).all(axis=1) | ~np.isfinite(values[:, _LINEAR]).all(axis=1)
    bad |= ~plausible_rates(values[:, _ANGULAR])
    kept, stamps = used_messages(bag.path, topic, heads.stamps, heads.broken | bad, issues)
    angular, linear = values[kept, _ANGULAR], values[kept, _LINEAR] / GRAVITY
    frame = next((frame_name(texts[0]) for texts in heads.texts if texts), "")
    placed = tree.place(frame, base) if base is not None else None
    rotation = np.eye(3) if placed is None else placed.pose[:3, :3]
    if np.abs(rotation - np.eye(3)).max() > _LEVEL:
        angular, linear = angular @ rotation.T, linear @ rotation.T
        turn = math.degrees(math.acos(min(1.0, max(-1.0, (float(np.trace(rotation)) - 1) / 2))))
        text = f"{bag.path.name}: {topic.name}: {frame} is turned by {turn:.1f} degrees in {base}; its readings are"
        issues.append(Issue("imu-turned", f"{text} turned into the robot's axes"))
    return ImuStream(stamps, angular, linear)


def left_aside(path: Path, what: str, used: Topic, others: list[Topic], issues: list[Issue]) -> None:
    """An issue that names the topics of a kind that are not used, if there are any."""
    if others:
        names = ", ".join(f"{topic.name} ({counted(len(topic), 'message')})" for topic in others[:8])
        text = f"{path.name}: {what} of {used.name} ({counted(len(used), 'message')}) used; left aside: {names}"
        issues.append(Issue("topics-left", text, len(others)))
