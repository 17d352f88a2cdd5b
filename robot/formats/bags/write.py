"""A recording as a ROS bag, which SLAM systems for ROS play and this package reads back: in three kinds.

Frames are ``odom``, ``base_link``, ``laser`` and the optical frames of the camera, topics those that navigation
stacks subscribe to by default. Depths are whole millimetres, as REP 118 has them in 16 bits: nearer than 0.6 m, where a
step of the raw disparity is less than one, a disparity reads back as one of those within a millimetre.

Beside the messages stands a ``std_msgs/String``, a TOML text: which streams the recording had (the others were computed
for those who play the bag), its platform, and the scans' figures, which ``sensor_msgs/LaserScan`` holds as float32.
"""

from __future__ import annotations

import heapq
import sqlite3
import tempfile
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any, Literal

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot import rgbd, se2
from moteslam.robot.files import make_folder
from moteslam.robot.formats.bags.bag import Bag
from moteslam.robot.formats.bags.frames import TRANSFORMS
from moteslam.robot.formats.bags.images import CAMERA_INFO, COMPRESSED_IMAGE
from moteslam.robot.formats.bags.messages import (
    Event,
    Values,
    header,
    nanoseconds,
    stamp,
    transform,
    turned,
    vector,
    write_events,
)
from moteslam.robot.formats.bags.motion import GRAVITY, IMU, JOINT_STATE, ODOMETRY, angle_of_count
from moteslam.robot.formats.bags.scans import LASER_SCAN
from moteslam.robot.formats.streams import Fan
from moteslam.robot.formats.written import SCAN_POSES, WrittenOdometry, not_written, odometry_of
from moteslam.robot.platform import CameraSpec, Platform
from moteslam.robot.platforms import platform_of, platform_table
from moteslam.robot.raster import encode_png
from moteslam.robot.recording import CHUNK, STREAMS, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.values import Issue, counted, expect_type

ODOM, BASE, LASER = "odom", "base_link", "laser"
RGB, DEPTH = "/camera/rgb", "/camera/depth"
_RGB_FRAME, _DEPTH_FRAME = "camera_rgb_optical_frame", "camera_depth_optical_frame"
_FORMATS = {RGB: "rgb8; png compressed bgr8", DEPTH: "16UC1; png compressed"}
_FARTHEST = 65.535

JOINTS = ("front_right_wheel_joint", "front_left_wheel_joint", "rear_right_wheel_joint", "rear_left_wheel_joint")
"""As written, in the order of an `EncoderStream`."""
LATEST = 2.0**31
"""The end of what messages hold as a time [s]: the year 2038."""
_METADATA_VERSION = 8
"""Of ``metadata.yaml``: ROS 2 Iron writes it, and releases from Humble on read it."""


Kind = Literal["bag", "mcap", "rosbag2"]

MANIFEST = ("/moteslam/recording", "std_msgs/String")
MAX_LETTERS = 1 << 20
FIGURES = ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")


@dataclass(frozen=True)
class Manifest:
    """What a bag says about the recording that it was written from: its streams, robot and figures of the scans."""

    streams: tuple[str, ...]
    platform: Platform
    scan: dict[str, Any]

    def sharpened(self, fan: Fan) -> Fan:
        """The fan with the figures that the messages round, wherever they round to those of the messages."""
        exact: dict[str, Any] = {name: value for name in FIGURES if isinstance(value := self.scan.get(name), float)}
        rounded = {name: np.float32(getattr(fan, name)) for name in exact}
        return fan._replace(**{name: value for name, value in exact.items() if np.float32(value) == rounded[name]})


def manifest_of(recording: Recording, *, with_odometry: bool) -> str:
    """The text for a recording; ``with_odometry`` where that of the bag was not computed."""
    lidar = recording.lidar
    has = {name: with_odometry if name == "odometry" else getattr(recording, name) is not None for name in STREAMS}
    table = {
        "streams": [name for name in STREAMS if has[name]],
        "scan": {} if lidar is None else {name: float(getattr(lidar, name)) for name in FIGURES},
        "platform": platform_table(recording.platform),
    }
    return tomli_w.dumps(table)


def read_manifest(bag: Bag) -> Manifest | None:
    """What a bag says about its recording; None of a bag that this package did not write."""
    topic = next((topic for topic in bag.of_kind(MANIFEST[1]) if topic.name == MANIFEST[0]), None)
    if topic is None:
        return None
    try:
        _, _, _, data = next(bag.sweep([topic]))
        if len(text := bag.decode(topic, data).data) > MAX_LETTERS:
            raise ValueError(f"{len(text)} letters")
        table = tomllib.loads(text)
        streams, scan, robot = table["streams"], dict(table["scan"]), dict(table["platform"])
        return Manifest(tuple(name for name in STREAMS if name in streams), platform_of(robot, file=bag.path), scan)
    except (ValueError, TypeError, KeyError, RecursionError, StopIteration, ConfigError) as error:
        problem = f"{' '.join(str(error).split())[:200]}, expected the description of a recording"
        raise InputError(problem, file=bag.path, field=MANIFEST[0]) from error


def write_bag(path: str | PathLike[str], recording: Recording, *, kind: Kind) -> tuple[Issue, ...]:
    """Write a recording as a new bag; topics and what comes back equal: ``docs/reference/formats.md``.

    The same recording gives the same bytes. What the bag does not hold is an issue each.

    Args:
        path: of a new file or, of the kind ``rosbag2``, a folder for a SQLite file and its ``metadata.yaml``.
        recording: what to write.
        kind: a file of ROS 1, or of ROS 2 a single MCAP file or a folder.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    path = Path(path)
    for name, stamps in recording.stamps().items():
        if len(stamps) and not (stamps[0] >= 0 and stamps[-1] < LATEST - 1):
            worst = float(stamps[0] if stamps[0] < 0 else stamps[-1])
            problem = f"stamp of {worst:.6g} s, expected 0 to 2^31 s, as ROS messages hold them"
            raise InputError(problem, file=recording.name, field=name)
    odometry, missing = odometry_of(recording), list[int]()
    events = events_of(recording, odometry, missing)
    try:
        if kind == "bag":
            from rosbags.rosbag1 import Writer

            with Writer(path) as writer:
                write_events(writer, events, ros1=True)
        else:
            _write_ros2(path, kind, events)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=path) from error
    return (*odometry.issues, *_left_out(recording, len(missing)))


def _write_ros2(path: Path, kind: Kind, events: Iterator[Event]) -> None:
    """Write a folder beside the target, as rosbags does, and move its files to their place."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    if kind == "rosbag2":
        make_folder(path)
    with tempfile.TemporaryDirectory(prefix=".moteslam-", dir=path.absolute().parent) as place:
        folder = Path(place) / ("written" if kind == "mcap" else "recording")
        with Writer(folder, version=_METADATA_VERSION, storage_plugin=storage) as writer:
            write_events(writer, events, ros1=False)
        if kind == "mcap":
            (folder / "written.mcap").replace(path)
            return
        for file in folder.iterdir():
            file.replace(path / file.name)


def _left_out(recording: Recording, missing: int) -> Iterator[Issue]:
    """What a bag does not hold of a recording."""
    if recording.platform.wheels is None:
        yield from not_written(recording, "a bag of a platform without wheels", "encoders")
    if recording.odometry is not None:
        yield from not_written(recording, "a bag beside its odometry", SCAN_POSES)
    if (stream := recording.rgbd) is not None and not rgbd.has_images(stream):
        yield from not_written(recording, "a bag without the images themselves", "rgbd")
    elif stream is not None:
        text = f"{recording.name}: depths are written in millimetres: nearer than 0.6 m disparities may be rounded"
        yield Issue("depths-rounded", text, len(stream.disparity_stamps))
    if missing:
        text = f"{recording.name}: {counted(missing, 'image')} missing or unreadable: not written"
        yield Issue("images-missing", text, missing)


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
        Event(begin, *MANIFEST, manifest, latched=True),
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
        rows = ({"name": list(JOINTS), "position": row} for row in angles)
        streams.append(_stamped(encoders.stamps, "/joint_states", JOINT_STATE, "", rows))
    if imu is not None:
        unknown = np.array([-1.0, *[0.0] * 8])  # no orientation is measured: sensor_msgs/Imu
        pushes = (imu.linear_acceleration_g * GRAVITY).tolist()
        readings = (
            {
                "orientation": turned(0.0),
                "orientation_covariance": unknown,
                "angular_velocity": vector(*angular),
                "linear_acceleration": vector(*linear),
            }
            for angular, linear in zip(imu.angular_velocity.tolist(), pushes, strict=True)
        )
        streams.append(_stamped(imu.stamps, "/imu", IMU, BASE, readings))
    if lidar is not None:
        streams.append(_stamped(lidar.stamps, "/scan", LASER_SCAN, LASER, _scans(lidar)))
    if recording.rgbd is not None and rgbd.has_images(recording.rgbd):
        streams += image_events(recording.rgbd, missing)
    yield from heapq.merge(*streams, key=lambda event: event.time)


def _stamped(stamps: NDArray[np.float64], topic: str, kind: str, frame: str, rows: Iterator[Values]) -> Iterator[Event]:
    """The messages of a topic, with their headers."""
    for time, row in zip(nanoseconds(stamps).tolist(), rows, strict=True):
        yield Event(time, topic, kind, {"header": header(time, frame), **row})


def _odometry(odometry: OdometryStream) -> Iterator[Event]:
    rates = twists(odometry.stamps, odometry.poses)
    rows = (
        {
            "child_frame_id": BASE,
            "pose": {"pose": {"position": vector(x, y, 0.0), "orientation": turned(yaw)}},
            "twist": {"twist": {"linear": vector(forward, left, 0.0), "angular": vector(0.0, 0.0, turn)}},
        }
        for (x, y, yaw), (forward, left, turn) in zip(odometry.poses.tolist(), rates.tolist(), strict=True)
    )
    return _stamped(odometry.stamps, "/odom", ODOMETRY, ODOM, rows)


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


def _scans(lidar: LidarStream) -> Iterator[Values]:
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
        yield from ({**figures, "ranges": ranges} for ranges in rows)


def image_events(stream: RgbdStream, missing: list[int]) -> list[Iterator[Event]]:
    """The colour and the depth images, packed as PNG, each with the CameraInfo of the Kinect."""

    def images(stamps: NDArray[np.float64], camera: str, frame: str) -> Iterator[Event]:
        for index, time in enumerate(nanoseconds(stamps).tolist()):
            try:
                pixels = rgbd.rgb_image(stream, index) if camera == RGB else _depth(stream, index)
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
    turn = dict(zip(names, Rotation.from_matrix(rgbd.mount_rotation(mount)).as_quat().tolist(), strict=True))
    return [
        transform(time, BASE, _DEPTH_FRAME, (mount.x, mount.y, mount.z), turn),
        transform(time, _DEPTH_FRAME, _RGB_FRAME, (rgbd.RGB_OFFSET, 0.0, 0.0), turned(0.0)),
    ]


def _depth(stream: RgbdStream, index: int) -> NDArray[np.uint16] | None:
    """Depths [480, 640] in millimetres, 0 where nothing was seen."""
    if (disparity := rgbd.disparity_image(stream, index)) is None:
        return None
    depth = rgbd.depth_of(disparity)
    millimetres: NDArray[np.uint16] = np.rint(1000 * np.where(depth <= _FARTHEST, depth, 0.0)).astype(np.uint16)
    return millimetres


def _camera_info(camera: str) -> Values:
    """A pinhole camera without distortion; its matrices by the names of ROS 1 and of ROS 2."""
    focal, (column, row) = (rgbd.RGB_FOCAL, rgbd.RGB_CENTRE) if camera == RGB else (rgbd.FOCAL, rgbd.CENTRE)
    matrix = np.array((focal, 0, column, 0, focal, row, 0, 0, 1))
    projection = np.array((focal, 0, column, 0, 0, focal, row, 0, 0, 0, 1, 0))
    matrices = {"d": np.zeros(5), "k": matrix, "r": np.eye(3).ravel(), "p": projection}
    figures = {"height": rgbd.HEIGHT, "width": rgbd.WIDTH, "distortion_model": "plumb_bob"}
    return {**figures, **matrices, **{name.upper(): value for name, value in matrices.items()}}
