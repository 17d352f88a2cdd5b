"""What a bag is written from: the messages of a recording with their times, as plain values, in the order of time.

Frames are ``odom``, ``base_link``, ``laser`` and the optical frames of the camera, topics those that navigation
stacks subscribe to by default. Values are nested tables of what the message types hold; `serial.py` makes bytes.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bags.choice import JOINT_STATE, TRANSFORMS
from moteslam.robot.formats.bags.manifest import KIND as MANIFEST_KIND
from moteslam.robot.formats.bags.manifest import TOPIC as MANIFEST_TOPIC
from moteslam.robot.formats.bags.manifest import manifest_of
from moteslam.robot.formats.bags.motion import GRAVITY, IMU, ODOMETRY
from moteslam.robot.formats.bags.scans import LASER_SCAN
from moteslam.robot.formats.bags.times import SECOND, nanoseconds
from moteslam.robot.formats.bags.wheels import JOINTS, joint_angles
from moteslam.robot.formats.written_odometry import WrittenOdometry
from moteslam.robot.ranges import CHUNK
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording
from moteslam.robot.specs import LidarSpec

ODOM, BASE, LASER = "odom", "base_link", "laser"

Values = dict[str, Any]
"""A message: numbers, texts, arrays, tables of these and lists of tables, by the names of its fields."""

Places = Callable[[int], list[Values]]
"""Gives transforms, for a time [ns]."""


@dataclass(frozen=True, eq=False)
class Event:
    """A message at its time.

    Attributes:
        time: [ns], of its header.
        topic: with a leading slash.
        kind: the type, ``sensor_msgs/LaserScan``.
        values: what is in it.
        latched: whether those who come later get it as well.
    """

    time: int
    topic: str
    kind: str
    values: Values
    latched: bool = False


def events_of(
    recording: Recording,
    written: WrittenOdometry,
    *,
    images: Sequence[Iterator[Event]] = (),
    places: Places | None = None,
) -> Iterator[Event]:
    """The messages of a recording by their times; of equal ones what others rely on comes first.

    Args:
        recording: to write.
        written: its odometry.
        images: the messages of its images.
        places: gives, for a time [ns], the transforms to its cameras.

    Raises:
        InputError: no readings.
    """
    lidar, imu, encoders, odometry = recording.lidar, recording.imu, recording.encoders, written.stream
    streams: list[Iterator[Event]] = []
    stamps = [stream.stamps for stream in (odometry, lidar, imu, encoders) if stream is not None and len(stream)]
    if not stamps:
        raise InputError("no readings, expected scans, odometry, wheels or an IMU", file=recording.name)
    begin = int(nanoseconds(np.array([min(float(times[0]) for times in stamps)]))[0])
    cameras = places(begin) if places is not None else []
    streams.append(iter(_standing(recording, begin, cameras, with_odometry=written.is_stream)))
    ticks = [stream.stamps for stream in (odometry, lidar) if stream is not None]
    if ticks:
        streams.append(_clock(np.unique(nanoseconds(np.concatenate(ticks)))))
    if odometry is not None:
        streams += [_odometry(odometry), _transforms(odometry)]
    if encoders is not None and recording.platform.wheels is not None:
        streams.append(_wheels(encoders, recording))
    if imu is not None:
        streams.append(_imu(imu))
    if lidar is not None:
        streams.append(_scans(lidar))
    streams += images
    yield from heapq.merge(*streams, key=lambda event: event.time)


def header(time: int, frame: str) -> Values:
    """A header of a time [ns] and a frame."""
    return {"stamp": stamp(time), "frame_id": frame}


def stamp(time: int) -> Values:
    """A time [ns] as messages hold it."""
    return {"sec": time // SECOND, "nanosec": time % SECOND}


def transform(time: int, parent: str, child: str, place: tuple[float, float, float], turn: Values) -> Values:
    """A ``geometry_msgs/TransformStamped``."""
    moved = {"translation": vector(*place), "rotation": turn}
    return {"header": header(time, parent), "child_frame_id": child, "transform": moved}


def vector(x: float, y: float, z: float) -> Values:
    """A ``geometry_msgs/Vector3`` or ``Point``."""
    return {"x": x, "y": y, "z": z}


def turned(yaw: float) -> Values:
    """The quaternion of a turn about z [rad]."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}


def _standing(recording: Recording, time: int, cameras: list[Values], *, with_odometry: bool) -> list[Event]:
    """What holds throughout: the recording's description, and where the sensors stand."""
    mount: LidarSpec = recording.platform.lidar
    place = transform(time, BASE, LASER, (mount.x, mount.y, mount.z), turned(mount.yaw))
    return [
        Event(
            time,
            MANIFEST_TOPIC,
            MANIFEST_KIND,
            {"data": manifest_of(recording, with_odometry=with_odometry)},
            latched=True,
        ),
        Event(time, "/tf_static", TRANSFORMS[0], {"transforms": [place, *cameras]}, latched=True),
    ]


def _clock(times: NDArray[np.int64]) -> Iterator[Event]:
    for time in times.tolist():
        yield Event(time, "/clock", "rosgraph_msgs/Clock", {"clock": stamp(time)})


def _odometry(odometry: OdometryStream) -> Iterator[Event]:
    nothing = np.zeros(36)
    rates = twists(odometry.stamps, odometry.poses)
    times = nanoseconds(odometry.stamps).tolist()
    for time, (x, y, yaw), (forward, left, turn) in zip(times, odometry.poses.tolist(), rates.tolist(), strict=True):
        pose = {"position": vector(x, y, 0.0), "orientation": turned(yaw)}
        twist = {"linear": vector(forward, left, 0.0), "angular": vector(0.0, 0.0, turn)}
        values = {
            "header": header(time, ODOM),
            "child_frame_id": BASE,
            "pose": {"pose": pose, "covariance": nothing},
            "twist": {"twist": twist, "covariance": nothing},
        }
        yield Event(time, "/odom", ODOMETRY, values)


def _transforms(odometry: OdometryStream) -> Iterator[Event]:
    for time, (x, y, yaw) in zip(nanoseconds(odometry.stamps).tolist(), odometry.poses.tolist(), strict=True):
        moved = transform(time, ODOM, BASE, (x, y, 0.0), turned(yaw))
        yield Event(time, "/tf", TRANSFORMS[0], {"transforms": [moved]})


def twists(stamps: NDArray[np.float64], poses: se2.Poses) -> NDArray[np.float64]:
    """Velocities [n, 3] (forward, left, turn) [m/s, m/s, rad/s] in the robot's frame, by differences of poses.

    A pose has the mean velocity since the one before it, the first that of the second. One that shares its stamp with
    the one before has the velocity of that.
    """
    rates = np.zeros((len(stamps), 3))
    if len(stamps) < 2:
        return rates
    steps, elapsed = se2.between(poses[:-1], poses[1:]), np.diff(stamps)
    measured = np.flatnonzero(elapsed > 0)
    if len(measured):
        velocities = steps[measured] / elapsed[measured, None]
        rates[1:] = velocities[np.maximum(np.searchsorted(measured, np.arange(len(elapsed)), side="right") - 1, 0)]
    rates[0] = rates[1]
    return rates


def _wheels(encoders: EncoderStream, recording: Recording) -> Iterator[Event]:
    wheels = recording.platform.wheels
    assert wheels is not None
    nothing = np.empty(0)
    angles = joint_angles(encoders.counts, wheels)
    for time, row in zip(nanoseconds(encoders.stamps).tolist(), angles, strict=True):
        values = {
            "header": header(time, ""),
            "name": list(JOINTS),
            "position": row,
            "velocity": nothing,
            "effort": nothing,
        }
        yield Event(time, "/joint_states", JOINT_STATE, values)


def _imu(imu: ImuStream) -> Iterator[Event]:
    nothing, unknown = np.zeros(9), np.zeros(9)
    unknown[0] = -1.0  # no orientation is measured: sensor_msgs/Imu
    rows = zip(
        nanoseconds(imu.stamps).tolist(),
        imu.angular_velocity.tolist(),
        (imu.linear_acceleration_g * GRAVITY).tolist(),
        strict=True,
    )
    for time, angular, linear in rows:
        values = {
            "header": header(time, BASE),
            "orientation": turned(0.0),
            "orientation_covariance": unknown,
            "angular_velocity": vector(*angular),
            "angular_velocity_covariance": nothing,
            "linear_acceleration": vector(*linear),
            "linear_acceleration_covariance": nothing,
        }
        yield Event(time, "/imu", IMU, values)


def _scans(lidar: LidarStream) -> Iterator[Event]:
    times, nothing = nanoseconds(lidar.stamps), np.empty(0, np.float32)
    figures = {
        "angle_min": lidar.angle_min,
        "angle_max": lidar.angle_min + (lidar.ranges.shape[1] - 1) * lidar.angle_increment,
        "angle_increment": lidar.angle_increment,
        "time_increment": lidar.time_increment,
        "scan_time": float(np.median(np.diff(lidar.stamps))) if len(lidar) > 1 else 0.0,
        "range_min": lidar.range_min,
        "range_max": lidar.range_max,
    }
    for first in range(0, len(lidar), CHUNK):
        rows: NDArray[np.float32] = lidar.ranges[first : first + CHUNK]
        for time, ranges in zip(times[first : first + CHUNK].tolist(), rows, strict=True):
            values = {"header": header(time, LASER), **figures, "ranges": ranges, "intensities": nothing}
            yield Event(time, "/scan", LASER_SCAN, values)
