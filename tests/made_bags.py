"""Bags made for tests: messages of plain values, written by rosbags in every kind there is."""

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.robot.formats.bags.write import Event, header, transform, turned, vector, write_events
from moteslam.robot.recording import Recording

SECOND = 1_000_000_000
START = 1_600_000_000 * SECOND
"""When the bags made here begin [ns]."""

KINDS = ("bag", "bz2", "lz4", "mcap", "zstd", "folder", "mcap folder", "packed folder", "db3")
"""A ROS 1 file plain and packed, a single MCAP file plain and packed, ROS 2 folders, a single SQLite file."""

Events = Iterable[Event]


def make_bag(folder: Path, events: Events, kind: str = "bag", *, received: Sequence[int] | None = None) -> Path:
    """Write messages as a bag of a kind into a folder; ``received`` [ns] where that is not the header's time."""
    if received is not None:
        events = [replace(event, time=time) for event, time in zip(events, received, strict=True)]
    if kind in ("bag", "bz2", "lz4"):
        return _ros1(folder / "made.bag", events, kind)
    made = _ros2(folder / "made", events, kind)
    single = {"mcap": "made.mcap", "zstd": "made.mcap", "db3": "made.db3"}.get(kind)
    return made / single if single else made


def _ros1(path: Path, events: Events, kind: str) -> Path:
    from rosbags.rosbag1 import Writer

    writer = Writer(path)
    if kind != "bag":
        writer.set_compression(Writer.CompressionFormat[kind.upper()])
    with writer:
        write_events(writer, iter(events), ros1=True)
    return path


def _ros2(folder: Path, events: Events, kind: str) -> Path:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    is_mcap = kind in ("mcap", "zstd", "mcap folder")
    writer = Writer(folder, version=8, storage_plugin=StoragePlugin.MCAP if is_mcap else StoragePlugin.SQLITE3)
    if kind in ("zstd", "packed folder"):
        mode = CompressionMode.STORAGE if kind == "zstd" else CompressionMode.MESSAGE
        writer.set_compression(mode, CompressionFormat.ZSTD)
    with writer:
        write_events(writer, iter(events), ros1=False)
    return folder


def scan(
    time: float, ranges: Sequence[float] | np.ndarray, *, topic: str = "/scan", frame: str = "laser", **figures: Any
) -> Event:
    """A scan a number of seconds after the start; a fan of a quarter turn to each side unless figures say otherwise."""
    rows = np.asarray(ranges, np.float32)
    increment = math.pi / max(1, len(rows) - 1)
    values = {
        "header": header(START + round(time * SECOND), frame),
        "angle_min": -math.pi / 2,
        "angle_max": math.pi / 2,
        "angle_increment": increment,
        "time_increment": 0.0,
        "scan_time": 0.1,
        "range_min": 0.1,
        "range_max": 10.0,
        "ranges": rows,
        **figures,
    }
    return Event(START + round(time * SECOND), topic, "sensor_msgs/LaserScan", values)


def odometry(time: float, pose: tuple[float, float, float], *, topic: str = "/odom", child: str = "base_link") -> Event:
    x, y, yaw = pose
    stamp = START + round(time * SECOND)
    placed = {"pose": {"position": vector(x, y, 0), "orientation": turned(yaw)}}
    values = {"header": header(stamp, "odom"), "child_frame_id": child, "pose": placed}
    return Event(stamp, topic, "nav_msgs/Odometry", values)


def imu(time: float, rates: tuple[float, float, float], *, frame: str = "imu", topic: str = "/imu") -> Event:
    """An inertial reading of a sensor at rest, but for its rates."""
    stamp = START + round(time * SECOND)
    values = {
        "header": header(stamp, frame),
        "orientation": turned(0.0),
        "angular_velocity": vector(*rates),
        "linear_acceleration": vector(0.0, 0.0, 9.80665),
    }
    return Event(stamp, topic, "sensor_msgs/Imu", values)


def placed(
    time: float,
    parent: str,
    child: str,
    place: tuple[float, float, float] = (0.0, 0.0, 0.0),
    *,
    turn: dict[str, float] | None = None,
    topic: str = "/tf",
) -> Event:
    stamp = START + round(time * SECOND)
    values = {"transforms": [transform(stamp, parent, child, place, turn or turned(0.0))]}
    return Event(stamp, topic, "tf2_msgs/TFMessage", values)


def rolled(roll: float, yaw: float = 0.0) -> dict[str, float]:
    """The quaternion of a roll about x, then a yaw about z [rad]."""
    (s, c), (sy, cy) = ((math.sin(a / 2), math.cos(a / 2)) for a in (roll, yaw))
    return {"x": cy * s, "y": sy * s, "z": sy * c, "w": cy * c}


def drive(count: int = 20, beams: int = 19) -> Iterator[Event]:
    """Scans, odometry and an IMU of a robot that drives straight."""
    for index in range(count):
        time = 0.1 * index
        yield placed(time, "odom", "base_link", (time, 0.0, 0.0))
        yield odometry(time, (time, 0.0, 0.0))
        yield imu(time, (0.0, 0.0, 0.01 * index), frame="base_link")
        yield placed(time, "base_link", "laser", (0.2, 0.1, 0.3), topic="/tf_static")
        yield scan(time, np.linspace(1.0, 5.0, beams) + 0.01 * index)


def codes(recording: Recording) -> list[str]:
    return [issue.code for issue in recording.warnings]
