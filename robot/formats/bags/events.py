"""What a bag is written from: the messages of a recording with their times, as plain values, in the order of time.

Frames are ``odom``, ``base_link``, ``laser`` and the optical frames of the camera, topics those that navigation
stacks subscribe to by default. Depths are whole millimetres, as REP 118 has them in 16 bits: nearer than 0.6 m, where a
step of the raw disparity is less than one, a disparity reads back as one of those within a millimetre.
"""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.formats.bags.bag import SECOND
from moteslam.robot.formats.bags.frames import TRANSFORMS
from moteslam.robot.formats.bags.images import CAMERA_INFO, COMPRESSED_IMAGE
from moteslam.robot.formats.bags.manifest import KIND as MANIFEST_KIND
from moteslam.robot.formats.bags.manifest import TOPIC as MANIFEST_TOPIC
from moteslam.robot.formats.bags.manifest import manifest_of
from moteslam.robot.formats.bags.motion import GRAVITY, IMU, JOINT_STATE, ODOMETRY, angle_of_count
from moteslam.robot.formats.bags.scans import LASER_SCAN
from moteslam.robot.formats.bags.times import nanoseconds
from moteslam.robot.formats.ucsd_images import read_disparity, read_rgb
from moteslam.robot.formats.written import WrittenOdometry
from moteslam.robot.pictures import encode_png
from moteslam.robot.platform import CameraSpec
from moteslam.robot.recording import CHUNK, ImuStream, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.rgbd import (
    CENTRE,
    FOCAL,
    HEIGHT,
    RGB_CENTRE,
    RGB_FOCAL,
    RGB_OFFSET,
    WIDTH,
    depth_of,
    has_images,
    mount_rotation,
)

ODOM, BASE, LASER = "odom", "base_link", "laser"
RGB, DEPTH = "/camera/rgb", "/camera/depth"
_RGB_FRAME, _DEPTH_FRAME = "camera_rgb_optical_frame", "camera_depth_optical_frame"
_FORMATS = {RGB: "rgb8; png compressed bgr8", DEPTH: "16UC1; png compressed"}
_FARTHEST = 65.535

JOINTS = ("front_right_wheel_joint", "front_left_wheel_joint", "rear_right_wheel_joint", "rear_left_wheel_joint")
"""As written, in the order of an `EncoderStream`."""

Values = dict[str, Any]
"""A message: numbers, texts, arrays, tables of these and lists of tables, by the names of its fields; the others are 0
or empty."""


@dataclass(frozen=True, eq=False)
class Event:
    """A message of a topic and type at the time of its header [ns]; a latched one reaches those who come later."""

    time: int
    topic: str
    kind: str
    values: Values
    latched: bool = False


def events_of(recording: Recording, written: WrittenOdometry, missing: list[int]) -> Iterator[Event]:
    """The messages of a recording by their times; indices of images that cannot be read are added to ``missing``."""
    lidar, imu, encoders, odometry = recording.lidar, recording.imu, recording.encoders, written.stream
    stamps = [stream.stamps for stream in (odometry, lidar, imu, encoders) if stream is not None and len(stream)]
    if not stamps:
        raise InputError("no readings, expected scans, odometry, wheels or an IMU", file=recording.name)
    begin = int(nanoseconds(np.array([min(float(times[0]) for times in stamps)]))[0])
    mount, camera, wheels = recording.platform.lidar, recording.platform.camera, recording.platform.wheels
    standing = [transform(begin, BASE, LASER, (mount.x, mount.y, mount.z), turned(mount.yaw))]
    standing += [] if camera is None else camera_transforms(begin, camera)
    manifest = {"data": manifest_of(recording, with_odometry=not written.is_computed)}
    once = [
        Event(begin, MANIFEST_TOPIC, MANIFEST_KIND, manifest, latched=True),
        Event(begin, "/tf_static", TRANSFORMS[0], {"transforms": standing}, latched=True),
    ]
    streams: list[Iterator[Event]] = [iter(once)]
    if ticks := [stream.stamps for stream in (odometry, lidar) if stream is not None]:
        times = np.unique(nanoseconds(np.concatenate(ticks))).tolist()
        streams.append(Event(time, "/clock", "rosgraph_msgs/Clock", {"clock": stamp(time)}) for time in times)
    if odometry is not None:
        streams += [_odometry(odometry), _transforms(odometry)]
    if encoders is not None and wheels is not None:
        angles = np.cumsum(encoders.counts, axis=0).astype(np.float64) * angle_of_count(wheels)
        streams.append(_wheels(nanoseconds(encoders.stamps).tolist(), angles))
    if imu is not None:
        streams.append(_imu(imu))
    if lidar is not None:
        streams.append(_scans(lidar))
    if recording.rgbd is not None and has_images(recording.rgbd):
        streams += image_events(recording.rgbd, missing)
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


def _odometry(odometry: OdometryStream) -> Iterator[Event]:
    rates = twists(odometry.stamps, odometry.poses)
    times = nanoseconds(odometry.stamps).tolist()
    for time, (x, y, yaw), (forward, left, turn) in zip(times, odometry.poses.tolist(), rates.tolist(), strict=True):
        pose = {"position": vector(x, y, 0.0), "orientation": turned(yaw)}
        twist = {"linear": vector(forward, left, 0.0), "angular": vector(0.0, 0.0, turn)}
        values = {
            "header": header(time, ODOM),
            "child_frame_id": BASE,
            "pose": {"pose": pose},
            "twist": {"twist": twist},
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


def _wheels(times: list[int], angles: NDArray[np.float64]) -> Iterator[Event]:
    for time, row in zip(times, angles, strict=True):
        values = {"header": header(time, ""), "name": list(JOINTS), "position": row}
        yield Event(time, "/joint_states", JOINT_STATE, values)


def _imu(imu: ImuStream) -> Iterator[Event]:
    unknown = np.array([-1.0, *[0.0] * 8])  # no orientation is measured: sensor_msgs/Imu
    rates, pushes = imu.angular_velocity.tolist(), (imu.linear_acceleration_g * GRAVITY).tolist()
    for time, angular, linear in zip(nanoseconds(imu.stamps).tolist(), rates, pushes, strict=True):
        values = {
            "header": header(time, BASE),
            "orientation": turned(0.0),
            "orientation_covariance": unknown,
            "angular_velocity": vector(*angular),
            "linear_acceleration": vector(*linear),
        }
        yield Event(time, "/imu", IMU, values)


def _scans(lidar: LidarStream) -> Iterator[Event]:
    times = nanoseconds(lidar.stamps)
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
            values = {"header": header(time, LASER), **figures, "ranges": ranges}
            yield Event(time, "/scan", LASER_SCAN, values)


def image_events(stream: RgbdStream, missing: list[int]) -> list[Iterator[Event]]:
    """The colour and the depth images, packed as PNG, each with the CameraInfo of the Kinect."""

    def images(stamps: NDArray[np.float64], camera: str, frame: str) -> Iterator[Event]:
        for index, time in enumerate(nanoseconds(stamps).tolist()):
            try:
                pixels = _colour(stream, index) if camera == RGB else _depth(stream, index)
            except InputError:
                pixels = None
            if pixels is None:
                missing.append(index)
                continue
            head = header(time, frame)
            yield Event(time, f"{camera}/camera_info", CAMERA_INFO, {"header": head, **_camera_info(camera)})
            content = np.frombuffer(encode_png(pixels, fast=True), np.uint8)
            values = {"header": head, "format": _FORMATS[camera], "data": content}
            yield Event(time, f"{camera}/image_raw/compressed", COMPRESSED_IMAGE, values)

    return [images(stream.rgb_stamps, RGB, _RGB_FRAME), images(stream.disparity_stamps, DEPTH, _DEPTH_FRAME)]


def camera_transforms(time: int, mount: CameraSpec) -> list[Values]:
    """Where the two cameras stand: the depth camera on the robot, the colour camera to the right of it."""
    from scipy.spatial.transform import Rotation

    names = ("x", "y", "z", "w")
    turn = dict(zip(names, Rotation.from_matrix(mount_rotation(mount)).as_quat().tolist(), strict=True))
    return [
        transform(time, BASE, _DEPTH_FRAME, (mount.x, mount.y, mount.z), turn),
        transform(time, _DEPTH_FRAME, _RGB_FRAME, (RGB_OFFSET, 0.0, 0.0), turned(0.0)),
    ]


def _colour(stream: RgbdStream, index: int) -> NDArray[Any] | None:
    if stream.images is not None:
        return stream.images.rgb(index)
    path = stream.rgb_files[index]
    return None if path is None else read_rgb(path)


def _depth(stream: RgbdStream, index: int) -> NDArray[Any] | None:
    """Depths [480, 640] in millimetres, 0 where nothing was seen."""
    if stream.images is not None:
        disparity = stream.images.disparity(index)
    elif (path := stream.disparity_files[index]) is not None:
        disparity = read_disparity(path)
    else:
        return None
    depth = depth_of(disparity)
    millimetres: NDArray[np.uint16] = np.rint(1000 * np.where(depth <= _FARTHEST, depth, 0.0)).astype(np.uint16)
    return millimetres


def _camera_info(camera: str) -> Values:
    """A pinhole camera without distortion; its matrices by the names of ROS 1 and of ROS 2."""
    focal, (column, row) = (RGB_FOCAL, RGB_CENTRE) if camera == RGB else (FOCAL, CENTRE)
    matrix = np.array((focal, 0, column, 0, focal, row, 0, 0, 1))
    projection = np.array((focal, 0, column, 0, 0, focal, row, 0, 0, 0, 1, 0))
    matrices = {"d": np.zeros(5), "k": matrix, "r": np.eye(3).ravel(), "p": projection}
    figures = {"height": HEIGHT, "width": WIDTH, "distortion_model": "plumb_bob"}
    return {**figures, **matrices, **{name.upper(): value for name, value in matrices.items()}}
