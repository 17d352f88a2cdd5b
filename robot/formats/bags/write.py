"""A recording as a ROS bag, which SLAM systems for ROS play and this package reads back: in three kinds.

Frames are ``odom``, ``base_link``, ``laser`` and the optical frames of the camera, topics those that navigation
stacks subscribe to by default. Depths are whole millimetres, as REP 118 has them in 16 bits: nearer than 0.6 m, where a
step of the raw disparity is less than one, a disparity reads back as one of those within a millimetre.

Beside the messages stands a ``std_msgs/String``, a TOML text: which streams the recording had (the others were computed
for those who play the bag), its platform, and the scans' figures, which ``sensor_msgs/LaserScan`` holds as float32.
"""

import heapq
import math
import sqlite3
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import InputError, OutputError
from moteslam.files import make_folder
from moteslam.robot import rgbd, se2
from moteslam.robot.formats.bags import motion
from moteslam.robot.formats.bags.bag import SECOND
from moteslam.robot.formats.bags.definitions import full_name, store
from moteslam.robot.formats.bags.scans import LASER_SCAN
from moteslam.robot.formats.written import SCAN_POSES, WrittenOdometry, not_written, odometry_of
from moteslam.robot.platform import CameraSpec
from moteslam.robot.platforms import platform_table
from moteslam.robot.raster import encode_png
from moteslam.robot.recording import STREAMS, LidarStream, OdometryStream, Recording, RgbdStream, chunks
from moteslam.robot.values import Issue, counted, expect_type

ODOM, BASE, LASER = "odom", "base_link", "laser"
IMAGE_KINDS = IMAGE, COMPRESSED_IMAGE = "sensor_msgs/Image", "sensor_msgs/CompressedImage"
IMAGES = ("/camera/rgb/image_raw/compressed", "/camera/depth/image_raw/compressed")
_CAMERA_FRAMES = {"rgb": "camera_rgb_optical_frame", "depth": "camera_depth_optical_frame"}
_FORMATS = {"rgb": "rgb8; png compressed bgr8", "depth": "16UC1; png compressed"}
_FARTHEST = 65.535
JOINTS = ("front_right_wheel_joint", "front_left_wheel_joint", "rear_right_wheel_joint", "rear_left_wheel_joint")
LATEST = 2.0**31  # [s]: the end of what messages hold as a time, in 2038
_METADATA_VERSION = 8  # ROS 2 Iron writes it, and releases from Humble on read it
MANIFEST = ("/moteslam/recording", "std_msgs/String")
FIGURES = ("angle_min", "angle_increment", "range_min", "range_max", "time_increment")
_ARRAYS = {"float32": np.float32, "float64": np.float64, "uint8": np.uint8}

Values = dict[str, Any]
"""A message: numbers, texts, arrays, tables of these and lists of tables, by the names of its fields; the others are 0
or empty."""


@dataclass(frozen=True, eq=False)
class Event:
    """A message of a topic and type, and when it is received [ns]; a latched one reaches those who come later."""

    time: int
    topic: str
    kind: str
    values: Values
    latched: bool = False


def write_bag(path: str | PathLike[str], recording: Recording, *, kind: str) -> tuple[Issue, ...]:
    """Write a recording as a new ``bag`` of ROS 1, ``mcap`` file or ``rosbag2``: a folder with a SQLite file.

    The same recording gives the same bytes. What the bag does not hold is an issue each. Topics, and what comes back
    equal: ``docs/reference/formats.md``.
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
            write_ros2(path, kind, events)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=path) from error
    return (*odometry[2], *_left_out(recording, len(missing)))


def write_ros2(path: Path, kind: str, events: Iterator[Event]) -> None:
    """Write a folder beside the target, as rosbags does, and move its files to their place."""
    from rosbags.rosbag2 import StoragePlugin, Writer

    storage = StoragePlugin.MCAP if kind == "mcap" else StoragePlugin.SQLITE3
    if kind == "rosbag2":
        make_folder(path)
    with tempfile.TemporaryDirectory(prefix=".moteslam-", dir=path.absolute().parent) as place:
        folder = Path(place) / ("written" if kind == "mcap" else "recording")
        with Writer(folder, version=_METADATA_VERSION, storage_plugin=storage) as writer:
            write_events(writer, events, ros1=False)
        for file in folder.glob("*.mcap" if kind == "mcap" else "*"):
            file.replace(path if kind == "mcap" else path / file.name)


def _left_out(recording: Recording, missing: int) -> Iterator[Issue]:
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


def write_events(writer: Any, events: Iterator[Event], *, ros1: bool) -> None:
    """Write messages by a writer of rosbags, each topic's connection before its first."""
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    reliable, local = QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL
    forever, live = QosTime(2147483647, 4294967295), QosLiveliness.AUTOMATIC
    profile = Qos(QosHistory.KEEP_LAST, 1, reliable, local, forever, forever, live, forever, False)
    latched: Values = {"latching": 1} if ros1 else {"offered_qos_profiles": [profile]}
    types, connections = store(ros1=ros1), dict[str, Any]()
    for event in events:
        name = full_name(event.kind)
        if event.topic not in connections:
            options = latched if event.latched else {}
            connections[event.topic] = writer.add_connection(event.topic, name, typestore=types, **options)
        message = _message(types, name, event.values)
        data = types.serialize_ros1(message, name) if ros1 else types.serialize_cdr(message, name)
        writer.write(connections[event.topic], event.time, bytes(data))


def _message(types: Any, name: str, values: Values) -> Any:
    made = {}
    for field, (how, what) in types.fielddefs[name][1]:
        value: Any = values.get(field)
        if how.name == "NAME":
            value = _message(types, what, value or {})
        elif how.name == "BASE" and value is None:
            value = "" if what[0] == "string" else 0
        elif how.name != "BASE":  # an array of messages or of numbers
            (inner, element), size = what
            if inner.name == "NAME":
                value = [_message(types, element, one) for one in value or ()]
            elif element[0] in _ARRAYS:
                value = np.asarray(np.zeros(size) if value is None else value, _ARRAYS[element[0]])
        made[field] = value
    return types.types[name](**made)


def events_of(recording: Recording, written: WrittenOdometry, missing: list[int]) -> Iterator[Event]:
    """The messages of a recording by their times; indices of images that cannot be read are added to ``missing``."""
    lidar, imu, encoders, (odometry, is_computed, _) = recording.lidar, recording.imu, recording.encoders, written
    firsts = [stream.stamps[:1] for stream in (odometry, lidar, imu, encoders) if stream is not None and len(stream)]
    if not firsts:
        raise InputError("no readings, expected scans, odometry, wheels or an IMU", file=recording.name)
    begin = int(nanoseconds(np.min(firsts, axis=0))[0])
    mount, camera, wheels = recording.platform.lidar, recording.platform.camera, recording.platform.wheels
    standing = [transform(begin, BASE, LASER, (mount.x, mount.y, mount.z), turned(mount.yaw))]
    standing += [] if camera is None else camera_transforms(begin, camera)
    has = {name: getattr(recording, name) is not None for name in STREAMS} | {"odometry": not is_computed}
    about = {
        "streams": [name for name in STREAMS if has[name]],
        "scan": {} if lidar is None else {name: float(getattr(lidar, name)) for name in FIGURES},
        "platform": platform_table(recording.platform),
    }
    once = [
        Event(begin, *MANIFEST, {"data": tomli_w.dumps(about)}, latched=True),
        Event(begin, "/tf_static", motion.TRANSFORMS[0], {"transforms": standing}, latched=True),
    ]
    streams: list[Iterator[Event]] = [iter(once)]
    if ticks := [stream.stamps for stream in (odometry, lidar) if stream is not None]:
        times = np.unique(nanoseconds(np.concatenate(ticks))).tolist()
        clocks = ((time, {"clock": header(time, "")["stamp"]}) for time in times)
        streams.append(Event(time, "/clock", "rosgraph_msgs/Clock", clock) for time, clock in clocks)
    if odometry is not None:
        streams.append(_moves(odometry))
    if encoders is not None and wheels is not None:
        angles = np.cumsum(encoders.counts, axis=0).astype(np.float64) * motion.angle_of_count(wheels)
        rows = ({"name": list(JOINTS), "position": row} for row in angles)
        streams.append(_stamped(encoders.stamps, "/joint_states", motion.JOINT_STATE, "", rows))
    if imu is not None:
        unknown = np.array([-1.0, *[0.0] * 8])  # no orientation is measured: sensor_msgs/Imu
        pushes = (imu.linear_acceleration_g * motion.GRAVITY).tolist()
        readings = (
            {
                "orientation": turned(0.0),
                "orientation_covariance": unknown,
                "angular_velocity": vector(*angular),
                "linear_acceleration": vector(*linear),
            }
            for angular, linear in zip(imu.angular_velocity.tolist(), pushes, strict=True)
        )
        streams.append(_stamped(imu.stamps, "/imu", motion.IMU, BASE, readings))
    if lidar is not None:
        streams.append(_stamped(lidar.stamps, "/scan", LASER_SCAN, LASER, _scans(lidar)))
    if recording.rgbd is not None and rgbd.has_images(recording.rgbd):
        streams += image_events(recording.rgbd, missing)
    yield from heapq.merge(*streams, key=lambda event: event.time)


def _stamped(stamps: NDArray[np.float64], topic: str, kind: str, frame: str, rows: Iterator[Values]) -> Iterator[Event]:
    for time, row in zip(nanoseconds(stamps).tolist(), rows, strict=True):
        yield Event(time, topic, kind, {"header": header(time, frame), **row})


def _moves(odometry: OdometryStream) -> Iterator[Event]:
    times, rates = nanoseconds(odometry.stamps).tolist(), twists(odometry.stamps, odometry.poses).tolist()
    for time, (x, y, yaw), (forward, left, turn) in zip(times, odometry.poses.tolist(), rates, strict=True):
        values = {
            "header": header(time, ODOM),
            "child_frame_id": BASE,
            "pose": {"pose": {"position": vector(x, y, 0.0), "orientation": turned(yaw)}},
            "twist": {"twist": {"linear": vector(forward, left, 0.0), "angular": vector(0.0, 0.0, turn)}},
        }
        yield Event(time, "/odom", motion.ODOMETRY, values)
        moved = transform(time, ODOM, BASE, (x, y, 0.0), turned(yaw))
        yield Event(time, "/tf", motion.TRANSFORMS[0], {"transforms": [moved]})


def twists(stamps: NDArray[np.float64], poses: se2.Poses) -> NDArray[np.float64]:
    """Velocities [n, 3] (forward, left, turn) [m/s, m/s, rad/s] in the robot's frame: the means since the pose before,
    of the first those of the second. A pose that shares its stamp with the one before has the velocity of that.
    """
    steps, elapsed = se2.between(poses[:-1], poses[1:]), np.diff(stamps)
    if not (elapsed > 0).any():
        return np.zeros((len(stamps), 3))
    measured = np.flatnonzero(elapsed > 0)
    latest = np.searchsorted(measured, np.arange(-1, len(elapsed)), side="right") - 1
    return np.asarray((steps[measured] / elapsed[measured, None])[np.maximum(latest, 0)])


def _scans(lidar: LidarStream) -> Iterator[Values]:
    figures = {name: getattr(lidar, name) for name in FIGURES}
    figures["angle_max"] = lidar.angle_min + (lidar.ranges.shape[1] - 1) * lidar.angle_increment
    figures["scan_time"] = float(np.median(np.diff(lidar.stamps))) if len(lidar) > 1 else 0.0
    for rows in chunks(lidar.ranges):
        yield from ({**figures, "ranges": ranges} for ranges in rows)


def image_events(stream: RgbdStream, missing: list[int]) -> list[Iterator[Event]]:
    """The colour and the depth images, packed as PNG, each with the CameraInfo of the Kinect."""

    def images(stamps: NDArray[np.float64], camera: str) -> Iterator[Event]:
        for index, time in enumerate(nanoseconds(stamps).tolist()):
            try:
                pixels = rgbd.rgb_image(stream, index) if camera == "rgb" else _depth(stream, index)
            except InputError:
                pixels = None
            if pixels is None:
                missing.append(index)
                continue
            head = {"header": header(time, _CAMERA_FRAMES[camera])}
            yield Event(time, f"/camera/{camera}/camera_info", "sensor_msgs/CameraInfo", head | _camera_info(camera))
            content = np.frombuffer(encode_png(pixels, fast=True), np.uint8)
            values = {**head, "format": _FORMATS[camera], "data": content}
            yield Event(time, f"/camera/{camera}/image_raw/compressed", COMPRESSED_IMAGE, values)

    return [images(stream.rgb_stamps, "rgb"), images(stream.disparity_stamps, "depth")]


def camera_transforms(time: int, mount: CameraSpec) -> list[Values]:
    """Where the two cameras stand: the depth camera on the robot, the colour camera to the right of it."""
    from scipy.spatial.transform import Rotation

    turn = dict(zip("xyzw", Rotation.from_matrix(rgbd.mount_rotation(mount)).as_quat().tolist(), strict=True))
    rgb, depth = _CAMERA_FRAMES["rgb"], _CAMERA_FRAMES["depth"]
    return [
        transform(time, BASE, depth, (mount.x, mount.y, mount.z), turn),
        transform(time, depth, rgb, (rgbd.RGB_OFFSET, 0.0, 0.0), turned(0.0)),
    ]


def _depth(stream: RgbdStream, index: int) -> NDArray[np.uint16] | None:
    """Depths [480, 640] in millimetres, 0 where nothing was seen."""
    disparity = rgbd.disparity_image(stream, index)
    depth = np.zeros(0) if disparity is None else rgbd.depth_of(disparity)
    return np.rint(1000 * np.where(depth <= _FARTHEST, depth, 0.0)).astype(np.uint16) if len(depth) else None


def _camera_info(camera: str) -> Values:
    """A pinhole camera without distortion; its matrices by the names of ROS 1 and of ROS 2."""
    focal, (column, row) = (rgbd.RGB_FOCAL, rgbd.RGB_CENTRE) if camera == "rgb" else (rgbd.FOCAL, rgbd.CENTRE)
    matrix = np.array((focal, 0, column, 0, focal, row, 0, 0, 1))
    projection = np.array((focal, 0, column, 0, 0, focal, row, 0, 0, 0, 1, 0))
    matrices = {"d": np.zeros(5), "k": matrix, "r": np.eye(3).ravel(), "p": projection}
    figures = {"height": rgbd.HEIGHT, "width": rgbd.WIDTH, "distortion_model": "plumb_bob"}
    return {**figures, **matrices, **{name.upper(): value for name, value in matrices.items()}}


def nanoseconds(stamps: NDArray[np.float64]) -> NDArray[np.int64]:
    """Stamps [s] as whole nanoseconds, rounded half to even.

    From 2^23 s on (97 days: all of Unix time) float64 is coarser than a nanosecond, and they read back bit for bit;
    below it to within half a nanosecond.
    """
    whole = np.floor(stamps)
    return whole.astype(np.int64) * SECOND + np.rint((stamps - whole) * SECOND).astype(np.int64)


def header(time: int, frame: str) -> Values:
    """A header of a time [ns] and a frame."""
    return {"stamp": {"sec": time // SECOND, "nanosec": time % SECOND}, "frame_id": frame}


def transform(time: int, parent: str, child: str, place: tuple[float, float, float], turn: Values) -> Values:
    """A ``geometry_msgs/TransformStamped``."""
    moved = {"translation": vector(*place), "rotation": turn}
    return {"header": header(time, parent), "child_frame_id": child, "transform": moved}


def vector(x: float, y: float, z: float) -> Values:
    """A ``Vector3`` or ``Point``."""
    return {"x": x, "y": y, "z": z}


def turned(yaw: float) -> Values:
    """The quaternion of a turn about z [rad]."""
    return {"x": 0.0, "y": 0.0, "z": math.sin(yaw / 2), "w": math.cos(yaw / 2)}
