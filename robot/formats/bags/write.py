"""A recording as a ROS bag, which SLAM systems for ROS play and this package reads back: in three kinds."""

from __future__ import annotations

import shutil
import sqlite3
import tempfile
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

from moteslam.errors import ExistsError, InputError, OutputError
from moteslam.robot.files import umask
from moteslam.robot.formats.bags.container import missing_extra
from moteslam.robot.formats.bags.events import Event, events_of
from moteslam.robot.formats.bags.image_events import ImageEvents, camera_transforms
from moteslam.robot.formats.bags.serial import Serialiser, full_name
from moteslam.robot.formats.not_written import left_out, not_written
from moteslam.robot.formats.written_odometry import odometry_of
from moteslam.robot.issues import Issue
from moteslam.robot.recording import Recording
from moteslam.robot.wording import counted, expect_type

LATEST = 2.0**31
"""The end of what messages hold as a time [s]: the year 2038."""

_METADATA_VERSION = 8
"""Of ``metadata.yaml``: ROS 2 Iron writes it, and releases from Humble on read it."""

Write = Callable[[Event], None]


def write_rosbag1(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a ROS 1 ``.bag``; topics and what comes back equal: ``docs/reference/formats.md``.

    The same recording gives the same bytes.

    Args:
        path: the file; one that is there is replaced.
        recording: to write.

    Returns:
        what the bag does not hold, an issue each.

    Raises:
        InputError: nothing to write, or stamps that messages cannot hold.
        OutputError: the file cannot be written.
    """

    def write(place: Path, events: Iterator[Event]) -> Path:
        from rosbags.rosbag1 import Writer

        file = place / "written.bag"
        with Writer(file) as writer:
            _write_all(writer, events, ros1=True)
        return file

    return _written(Path(path), recording, write)


def write_mcap(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a single ``.mcap`` file of ROS 2; else as `write_rosbag1`."""

    def write(place: Path, events: Iterator[Event]) -> Path:
        folder = place / "written"
        with _ros2_writer(folder, "MCAP") as writer:
            _write_all(writer, events, ros1=False)
        return folder / "written.mcap"

    return _written(Path(path), recording, write)


def write_rosbag2(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a ROS 2 bag: a folder with ``metadata.yaml`` and a SQLite file; else as `write_rosbag1`.

    Raises:
        ExistsError: the folder holds a bag already.
    """
    path = Path(path)

    def write(place: Path, events: Iterator[Event]) -> Path:
        folder = place / "recording"  # the file in it is called as the folder is here
        with _ros2_writer(folder, "SQLITE3") as writer:
            _write_all(writer, events, ros1=False)
        return folder

    if (path / "metadata.yaml").exists():
        raise ExistsError("holds a bag already, expected a new folder", file=path)
    return _written(path, recording, write)


def _ros2_writer(folder: Path, storage: str) -> AbstractContextManager[Any]:
    from rosbags.rosbag2 import StoragePlugin, Writer

    writer: AbstractContextManager[Any] = Writer(
        folder, version=_METADATA_VERSION, storage_plugin=StoragePlugin[storage]
    )
    return writer


def _write_all(writer: Any, events: Iterator[Event], *, ros1: bool) -> None:
    """Write messages, each topic's connection before its first."""
    serialiser = Serialiser(ros1=ros1)
    connections: dict[str, Any] = {}
    for event in events:
        if event.topic not in connections:
            latched = _latched(ros1=ros1) if event.latched else {}
            name, store = full_name(event.kind), serialiser.store
            connections[event.topic] = writer.add_connection(event.topic, name, typestore=store, **latched)
        writer.write(connections[event.topic], event.time, serialiser.bytes_of(event.kind, event.values))


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
    odometry = odometry_of(recording)
    images, camera = ImageEvents(recording), recording.platform.camera
    places = None if camera is None else partial(camera_transforms, mount=camera)
    events = events_of(recording, odometry, images=images.streams(), places=places)
    try:
        with tempfile.TemporaryDirectory(prefix=".moteslam-", dir=path.absolute().parent) as place:
            made = write(Path(place), events)
            made.chmod((0o777 if made.is_dir() else 0o666) & ~umask())
            if made.is_dir() and path.is_dir():
                for file in sorted(made.iterdir(), key=lambda file: file.suffix == ".yaml"):  # the metadata last
                    file.replace(path / file.name)
            else:
                made.replace(path)
    except ModuleNotFoundError as error:
        raise missing_extra(path) from error
    except (OSError, sqlite3.Error, shutil.Error) as error:
        raise OutputError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=path) from error
    return (*odometry.issues, *_left_out(recording), *images.issues())


def _check_stamps(recording: Recording) -> None:
    rgbd = recording.rgbd
    streams = {name: getattr(recording, name) for name in ("lidar", "encoders", "odometry", "imu")}
    found = {name: stream.stamps for name, stream in streams.items() if stream is not None}
    if rgbd is not None:
        found |= {"rgbd.rgb_stamps": rgbd.rgb_stamps, "rgbd.disparity_stamps": rgbd.disparity_stamps}
    for name, stamps in found.items():
        if not len(stamps):
            continue
        if not (stamps[0] >= 0 and stamps[-1] < LATEST - 1):
            worst = float(stamps[0] if stamps[0] < 0 else stamps[-1])
            problem = f"stamp of {worst:.6g} s, expected 0 to 2^31 s, as ROS messages hold them"
            raise InputError(problem, file=recording.name, field=name)


def _left_out(recording: Recording) -> tuple[Issue, ...]:
    """What a bag does not hold of a recording."""
    issues: tuple[Issue, ...] = ()
    if recording.platform.wheels is None:
        issues = not_written(recording, "a bag of a platform without wheels", ("encoders",))
    lidar = recording.lidar
    if lidar is not None and lidar.odometry is not None and recording.odometry is not None:
        poses = f"{counted(len(lidar), 'pose')} of scans"
        issues += (left_out(recording, "a bag beside its odometry", poses, len(lidar)),)
    return issues
