"""ROS bags: a recording from one, its topics chosen, gone through once and made into streams."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats import Format, Robot, Topics
from moteslam.robot.formats.bags.bag import Bag, Table, is_bag
from moteslam.robot.formats.bags.images import (
    CAMERA_INFO,
    COMPRESSED_IMAGE,
    IMAGE,
    camera_mount,
    image_tables,
    rgbd_stream,
)
from moteslam.robot.formats.bags.motion import (
    IMU,
    JOINT_STATE,
    ODOMETRY,
    TRANSFORMS,
    Frames,
    Mount,
    beside,
    choose_odometry,
    encoder_stream,
    imu_stream,
    left_aside,
    namespace,
    odometry_stream,
    pose_of,
    rates_of,
    wheel_angles,
)
from moteslam.robot.formats.bags.scans import LASER_SCAN, MULTI_ECHO, Scans, figures_of, laser_scans, merged_scans
from moteslam.robot.formats.bags.storage import Topic, is_readable
from moteslam.robot.formats.bags.write import MANIFEST, read_manifest, write_bag
from moteslam.robot.platform import CameraSpec, Platform
from moteslam.robot.platforms import GivenRobot, platform_of
from moteslam.robot.recording import ChunkedRanges, LidarStream, Recording
from moteslam.robot.values import Issue, counted

KINDS: Mapping[str, tuple[str, ...]] = {
    "lidar": (LASER_SCAN, MULTI_ECHO),
    "odometry": (ODOMETRY,),
    "imu": (IMU,),
    "encoders": (JOINT_STATE,),
    "rgb": (COMPRESSED_IMAGE, IMAGE),
    "depth": (COMPRESSED_IMAGE, IMAGE),
}
"""By stream, the types that it can be read from."""

NUMBERS: Mapping[str, tuple[Callable[[Any], tuple[float, ...]], int]] = {
    LASER_SCAN: (figures_of, 7),
    MULTI_ECHO: (figures_of, 7),
    ODOMETRY: (pose_of, 7),
    IMU: (rates_of, 6),
    JOINT_STATE: (wheel_angles, 4),
}
"""By type, what is kept of each message, and how many numbers that are."""

MANY = 0.75
"""A lidar with this share of the most scans competes with it."""
_NOT_LEVEL = ("vertical", "tilt", "nod")
"""In the name of a topic or frame of a lidar that does not scan the plane of the floor."""


def read_bag(
    path: str | PathLike[str],
    sequence: str | int | None = None,
    platform: Robot = None,
    topics: Topics | None = None,
) -> Recording:
    """Read a ROS bag: a ROS 1 ``.bag``, a ROS 2 folder, or a single ``.db3`` or ``.mcap`` file.

    Only headers are read here: ranges and images are read from the bag again whenever they are asked for. A table
    ``[lidars."/topic"]`` in the file of a platform gives the mount of one of several lidars. A stream of no topics is
    not read; one that ``topics`` leaves out is read by its types.
    """
    return _Reading(Bag(Path(path)), GivenRobot.read(platform), topics or {}, sequence).recording()


class _Reading:
    """A bag between its topics and its streams.

    Of several topics with a type the one with most messages is read, and an issue names the others. Of lidars with
    nearly as many scans, one whose topic is called vertical or tilted comes last. Wheels are read where they are named,
    or known by what this package wrote into the bag.
    """

    def __init__(self, bag: Bag, given: GivenRobot, topics: Topics, session: str | int | None) -> None:
        self.bag, self.frames = bag, Frames(bag)
        self.given, self.mounts = given.lidars()
        self.named = {stream: self._names(stream, names) for stream, names in topics.items()}
        self.about: Table | None = None
        tables = bag.fill(self._table_of)
        self.tables = [table for table in tables if is_readable(table.topic)]
        for table in tables:
            if table not in self.tables:
                what = f"{table.topic.kind} by another definition than the usual one, left aside"
                bag.tell("other-definition", table.topic, what, table.count)
        self._expect_named()
        is_ours = self.about is not None and self.about.first is not None
        self.manifest = read_manifest(self.about.first.data, file=bag.path) if is_ours else None
        written = self.manifest.streams if self.manifest is not None else ()
        is_computed = self.manifest is not None and "odometry" not in written
        self.lidars = self._of("lidar") if "lidar" in self.named else self._best_lidar()
        topic, frame = (self.lidars[0].topic.name, self.lidars[0].frame) if self.lidars else ("", "")
        imus = sorted(self._of("imu"), key=lambda table: not beside(table.topic.name, topic))
        if imus:
            left_aside(bag, "imu", imus[0], imus)
        self.imu = next(iter(imus), None)
        is_wheels = "encoders" in self.named or "encoders" in written
        self.encoders = next(iter(self._of("encoders")), None) if is_wheels else None
        is_without_images = () in (self.named.get("rgb"), self.named.get("depth"))
        self.images = None if is_without_images else image_tables(bag, self.tables, self.named)
        self.frames.keep(namespace(topic))
        if broken := sum(table.broken for table in self.tables if table.topic.kind in TRANSFORMS):
            bag.tell("broken-messages", "transforms", f"{counted(broken, 'broken message')} dropped", broken)
        odometries = [] if is_computed and "odometry" not in self.named else self._of("odometry")
        is_named = bool(self.named.get("odometry"))
        self.odometry = odometries[0] if is_named else choose_odometry(odometries, topic, frame, self.frames)
        edge = self.frames.odometry_under(frame)
        self.base = (self.odometry.child if self.odometry else "") or (edge.child if edge else self.frames.base())
        if self.odometry is None and not is_computed and "odometry" not in self.named:
            self.odometry = edge
        used = [*self.lidars, self.odometry, self.imu, self.encoders, *(self.images or ())]
        bag.choose_session([table for table in used if table is not None], session)

    def _names(self, stream: str, names: str | tuple[str, ...]) -> tuple[str, ...]:
        """The topics that are named for a stream; none where it is not read."""
        field = f"topics.{stream}"
        if stream not in KINDS:
            raise InputError(f"{stream!r}, expected {', '.join(KINDS)}", file=self.bag.path, field="topics")
        names = (names,) if isinstance(names, str) else tuple(names)
        if len(names) > 1 and stream != "lidar":
            raise InputError(f"{len(names)} topics, expected one", file=self.bag.path, field=field)
        full = tuple(name if name.startswith("/") else f"/{name}" for name in names)
        if len(set(full)) < len(full):
            raise InputError("a topic twice, expected each once", file=self.bag.path, field=field)
        return full

    def _expect_named(self) -> None:
        known = {stream: sorted(one.name for one in self.bag.topics if one.kind in KINDS[stream]) for stream in KINDS}
        for stream, names in self.named.items():
            there = {table.topic.name for table in self._of(stream)}
            if missing := [name for name in names if name not in there]:
                kinds = " or ".join(kind.partition("/")[2] for kind in KINDS[stream])
                expected = f"one of {', '.join(known[stream][:20])}" if known[stream] else f"a topic of {kinds}"
                problem = f"{missing[0]!r}, expected {expected}"
                raise InputError(problem, file=self.bag.path, field=f"topics.{stream}")
        if strange := [topic for topic in self.mounts if topic not in known["lidar"]]:
            raise InputError(f"no lidar {strange[0]!r}", file=self.given.file, field="lidars")

    def _table_of(self, topic: Topic) -> Table | None:
        """The table of a topic of which something is used, or may be."""
        if topic.encoding not in ("cdr", "ros1"):
            return None
        if topic.kind in TRANSFORMS:
            return Table(topic, partial(self.frames.add, topic=topic))
        if topic[:2] == MANIFEST:
            self.about = Table(topic, is_single=True)
            return self.about
        if topic.kind == CAMERA_INFO:
            return Table(topic, is_single=True)
        if topic.kind == JOINT_STATE and "encoders" not in self.named and self.about is None:
            return None
        streams = [stream for stream, kinds in KINDS.items() if topic.kind in kinds]
        if not any(topic.name in self.named.get(stream, (topic.name,)) for stream in streams):
            return None
        return Table(topic, *NUMBERS.get(topic.kind, ()))

    def _of(self, stream: str) -> list[Table]:
        """The tables that a stream can be read from: those named, in their order, else all, those with most first."""
        found = [table for table in self.tables if table.topic.kind in KINDS[stream]]
        names = self.named.get(stream)
        return found if names is None else [table for name in names for table in found if table.topic.name == name]

    def _best_lidar(self) -> list[Table]:
        tables = self._of("lidar")
        if not tables:
            return []
        enough = [table for table in tables if table.count >= MANY * tables[0].count]
        best = min(enough, key=lambda table: any(word in table.topic.name.lower() for word in _NOT_LEVEL))
        left_aside(self.bag, "scans", best, tables)
        return [best]

    def recording(self) -> Recording:
        """The streams, on the robot."""
        bag, path = self.bag, self.bag.path
        scans, mount = self._scans_and_mount()
        camera = camera_mount(self.images[1], self.frames, self.base) if self.images else None
        robot = self.given.platform or self.given.over(self._stated(scans, mount, camera))
        streams: dict[str, Any] = {"lidar": None if scans is None else self._lidar(scans, mount, robot)}
        if bag.has(self.odometry):
            streams["odometry"] = odometry_stream(bag, self.odometry)
        if bag.has(self.imu):
            streams["imu"] = imu_stream(self.imu, self.frames, self.base)
        if bag.has(self.encoders):
            # by the wheels that they were written by, else by those that are given
            wheels = robot.wheels if self.manifest is None else self.manifest.platform.wheels
            if wheels is None:
                problem = "joints of wheels, expected a platform with [wheels] to count them by"
                raise InputError(problem, file=path, field=self.encoders.topic.name)
            streams["encoders"] = encoder_stream(bag, self.encoders, wheels)
        if all(stream is None for stream in streams.values()):
            kinds = ", ".join(sorted({topic.kind[:60] for topic in bag.topics})[:8]) or "no topics"
            raise InputError(f"{kinds}: expected LaserScan, Odometry or Imu", file=path)
        if self.images is not None and robot.camera is not None:
            streams["rgbd"] = rgbd_stream(bag, *self.images)
        elif self.images is not None:
            text = f"{path.name}: images left out: no transform to the frame of {self.images[1].topic.name}"
            bag.issues.append(Issue("images-left", text, 2))
        name = path.resolve().name.removesuffix(path.suffix)
        return Recording(name=name, platform=robot, warnings=tuple(bag.issues), **streams)

    def _scans_and_mount(self) -> tuple[Scans | None, Mount]:
        """The scans of the lidar, or of several as one about the robot's centre, and where it stands."""
        scans = [laser_scans(self.bag, table) for table in self.lidars]
        if len(scans) > 1:
            return merged_scans(self.bag.path, scans, [self._mount(one) for one in scans]), Mount()
        return (scans[0], self._mount(scans[0])) if scans else (None, Mount())

    def _mount(self, scans: Scans) -> Mount:
        """Where a lidar stands by the transforms; where a caller says it, these matter only for which way is up."""
        given, alone = self.mounts.get(scans.topic), len(self.lidars) == 1
        is_given = given is not None or (
            alone and (self.given.platform is not None or {"x", "y", "yaw"} <= self.given.lidar_figures.keys())
        )
        told = len(self.bag.issues)
        try:
            mount = self.frames.lidar_mount(scans.topic, scans.frame, self.base)
        except InputError:
            if not is_given:
                raise
            mount = Mount()
        if is_given:
            del self.bag.issues[told:]
        return mount if given is None else Mount(given.x, given.y, given.z, given.yaw, mount.upside_down)

    def _stated(self, scans: Scans | None, mount: Mount, camera: CameraSpec | None) -> Platform:
        """The robot that the bag states: of one that this package wrote, the whole; else where its sensors stand."""
        if self.manifest is not None:
            return self.manifest.platform
        if scans is None:
            return Platform(camera=camera)
        place = {"x": mount.x, "y": mount.y, "z": mount.z, "yaw": mount.yaw}
        table = {"lidar": {**place, "time_increment": scans.fan.time_increment}}
        return platform_of(table, file=self.bag.path).model_copy(update={"camera": camera})

    def _lidar(self, scans: Scans, mount: Mount, robot: Platform) -> LidarStream:
        fan = self.manifest.sharpened(scans.fan) if self.manifest is not None else scans.fan
        fan = fan.flipped() if mount.upside_down else fan
        field = f"{scans.topic}: angle_increment"
        fan = fan.over(self.given.lidar_figures, fan.beams, file=self.bag.path, field=field)
        ranges = ChunkedRanges(
            lambda first, last: scans.cleaned(np.arange(first, last), fan), len(scans.stamps), fan.beams
        )
        return LidarStream(scans.stamps, ranges, *fan[:4], robot.lidar.time_increment)


_format = partial(Format, is_folder=False, read=read_bag, read_topics=read_bag)

ROSBAG1 = _format(
    "ROS 1 bag", recognise=partial(is_bag, kind="bag"), write=partial(write_bag, kind="bag"), endings=(".bag",)
)
MCAP = _format(
    "MCAP file of ROS",
    recognise=partial(is_bag, kind="mcap"),
    write=partial(write_bag, kind="mcap"),
    endings=(".mcap",),
)
DB3 = _format("SQLite file of ROS 2", recognise=partial(is_bag, kind="db3"))
ROSBAG2 = _format(
    "ROS 2 bag (a folder with metadata.yaml)",
    is_folder=True,
    recognise=is_bag,
    write=partial(write_bag, kind="rosbag2"),
)
