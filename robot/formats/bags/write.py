"""A recording as a ROS bag, which SLAM systems for ROS play and this package reads back: in three kinds."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import ExistsError, InputError, OutputError
from moteslam.robot.files import umask
from moteslam.robot.formats.bags.bag import full_name, store
from moteslam.robot.formats.bags.events import Event, Values, events_of
from moteslam.robot.formats.written import left_out, not_written, odometry_of
from moteslam.robot.recording import Recording
from moteslam.robot.rgbd import has_images
from moteslam.robot.values import Issue, counted, expect_type

LATEST = 2.0**31
"""The end of what messages hold as a time [s]: the year 2038."""

_METADATA_VERSION = 8
"""Of ``metadata.yaml``: ROS 2 Iron writes it, and releases from Humble on read it."""

_ARRAYS = {"float32": np.float32, "float64": np.float64, "uint8": np.uint8}


def write_rosbag1(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a ROS 1 ``.bag``; topics and what comes back equal: ``docs/reference/formats.md``.

    The same recording gives the same bytes. What the bag does not hold is an issue each.
    """

    def write(place: Path, events: Iterator[Event]) -> Path:
        from rosbags.rosbag1 import Writer

        with Writer(place / "written.bag") as writer:
            write_events(writer, events, ros1=True)
        return place / "written.bag"

    return _written(Path(path), recording, write)


def write_mcap(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a single ``.mcap`` file of ROS 2; else as `write_rosbag1`."""
    return _written(
        Path(path), recording, lambda place, events: _ros2(place / "written", "MCAP", events) / "written.mcap"
    )


def write_rosbag2(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a ROS 2 bag: a folder with ``metadata.yaml`` and a SQLite file; else as `write_rosbag1`."""
    path = Path(path)
    if (path / "metadata.yaml").exists():
        raise ExistsError("holds a bag already, expected a new folder", file=path)
    return _written(path, recording, lambda place, events: _ros2(place / "recording", "SQLITE3", events))


def _ros2(folder: Path, storage: str, events: Iterator[Event]) -> Path:
    from rosbags.rosbag2 import StoragePlugin, Writer

    with Writer(folder, version=_METADATA_VERSION, storage_plugin=StoragePlugin[storage]) as writer:
        write_events(writer, events, ros1=False)
    return folder


def write_events(writer: Any, events: Iterator[Event], *, ros1: bool, received: Iterator[int] | None = None) -> None:
    """Write messages, each topic's connection before its first; ``received`` [ns] where that is not their own time."""
    types = store(ros1=ros1)
    connections: dict[str, Any] = {}
    for event in events:
        name = full_name(event.kind)
        if event.topic not in connections:
            latched = _latched(ros1=ros1) if event.latched else {}
            connections[event.topic] = writer.add_connection(event.topic, name, typestore=types, **latched)
        time = event.time if received is None else next(received)
        writer.write(connections[event.topic], time, bytes_of(event.kind, event.values, ros1=ros1))


def bytes_of(kind: str, values: Values, *, ros1: bool) -> bytes:
    """A message of plain values, serialised as in ROS 1 or as CDR."""
    types, name = store(ros1=ros1), full_name(kind)
    message = _message(types, name, values)
    return bytes(types.serialize_ros1(message, name) if ros1 else types.serialize_cdr(message, name))


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


def _latched(*, ros1: bool) -> dict[str, Any]:
    """What makes a connection keep its last message for those who come later."""
    if ros1:
        return {"latching": 1}
    from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime

    forever = QosTime(2147483647, 4294967295)
    profile = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    return {"offered_qos_profiles": [profile]}


def _written(path: Path, recording: Recording, write: Callable[[Path, Iterator[Event]], Path]) -> tuple[Issue, ...]:
    """Write into a temporary folder beside the target, and put it in its place when it is whole."""
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    _check_stamps(recording)
    odometry, missing = odometry_of(recording), list[int]()
    try:
        with tempfile.TemporaryDirectory(prefix=".moteslam-", dir=path.absolute().parent) as place:
            made = write(Path(place), events_of(recording, odometry, missing))
            made.chmod((0o777 if made.is_dir() else 0o666) & ~umask())
            if made.is_dir() and path.is_dir():
                for file in sorted(made.iterdir(), key=lambda file: file.suffix == ".yaml"):  # the metadata last
                    file.replace(path / file.name)
            else:
                made.replace(path)
    except (OSError, sqlite3.Error, shutil.Error) as error:
        raise OutputError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=path) from error
    return (*odometry.issues, *_left_out(recording, len(missing)))


def _check_stamps(recording: Recording) -> None:
    rgbd = recording.rgbd
    streams = {name: getattr(recording, name) for name in ("lidar", "encoders", "odometry", "imu")}
    found = {name: stream.stamps for name, stream in streams.items() if stream is not None}
    if rgbd is not None:
        found |= {"rgbd.rgb_stamps": rgbd.rgb_stamps, "rgbd.disparity_stamps": rgbd.disparity_stamps}
    for name, stamps in found.items():
        if len(stamps) and not (stamps[0] >= 0 and stamps[-1] < LATEST - 1):
            worst = float(stamps[0] if stamps[0] < 0 else stamps[-1])
            problem = f"stamp of {worst:.6g} s, expected 0 to 2^31 s, as ROS messages hold them"
            raise InputError(problem, file=recording.name, field=name)


def _left_out(recording: Recording, missing: int) -> tuple[Issue, ...]:
    """What a bag does not hold of a recording."""
    issues: tuple[Issue, ...] = ()
    if recording.platform.wheels is None:
        issues = not_written(recording, "a bag of a platform without wheels", ("encoders",))
    lidar, rgbd = recording.lidar, recording.rgbd
    if lidar is not None and lidar.odometry is not None and recording.odometry is not None:
        poses = f"{counted(len(lidar), 'pose')} of scans"
        issues += (left_out(recording, "a bag beside its odometry", poses, len(lidar)),)
    if rgbd is not None and not has_images(rgbd):
        count = len(rgbd.rgb_stamps) + len(rgbd.disparity_stamps)
        stamps = counted(count, "stamp") + " of images"
        issues += (left_out(recording, "a bag without the images themselves", stamps, count),)
    elif rgbd is not None:
        text = f"{recording.name}: depths are written in millimetres: nearer than 0.6 m disparities may be rounded"
        issues += (Issue("depths-rounded", text, len(rgbd.disparity_stamps)),)
    if missing:
        text = f"{recording.name}: {counted(missing, 'image')} missing or unreadable: not written"
        issues += (Issue("images-missing", text, missing),)
    return issues
