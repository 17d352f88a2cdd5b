"""ROS bags: a recording from one, its topics chosen, gone through once and made into streams."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats import Format, Robot, Topics
from moteslam.robot.formats.bags.bag import Bag, Table, Topic, is_readable
from moteslam.robot.formats.bags.files import is_bag
from moteslam.robot.formats.bags.frames import TRANSFORMS, Frames, Mount
from moteslam.robot.formats.bags.images import COMPRESSED_IMAGE, IMAGE, camera_mount, image_topics, rgbd_stream
from moteslam.robot.formats.bags.motion import (
    IMU,
    JOINT_STATE,
    ODOMETRY,
    Joints,
    beside,
    choose_odometry,
    imu_stream,
    left_aside,
    odometry_stream,
    pose_of,
    rates_of,
)
from moteslam.robot.formats.bags.scans import (
    LASER_SCAN,
    MULTI_ECHO,
    Scans,
    figures_of,
    laser_scans,
    merged_scans,
)
from moteslam.robot.formats.bags.write import read_manifest, write_bag
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

MANY = 0.75
"""A lidar with this share of the most scans competes with it."""

MAX_CANDIDATES = 16
"""Topics of odometry that are read, to choose by their frames."""

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
    bag = Bag(Path(path))
    known = {*TRANSFORMS, *(kind for kinds in KINDS.values() for kind in kinds)}
    for topic in bag.topics:
        if topic.kind in known and topic.count and not is_readable(topic):
            what = f"{topic.kind} by another definition than the usual one, left aside"
            bag.tell("other-definition", topic, what, topic.count)
    return _Reading(bag, GivenRobot.read(platform), topics or {}, sequence).recording()


class _Reading:
    """A bag between its topics and its streams.

    Of several topics with a type the one with most messages is read, and an issue names the others. Of lidars with
    nearly as many scans, one whose topic is called vertical or tilted comes last. Wheels are read where they are named,
    or known by what this package wrote into the bag.
    """

    def __init__(self, bag: Bag, given: GivenRobot, topics: Topics, session: str | int | None) -> None:
        self.bag = bag
        self.given, self.mounts = given.lidars()
        if unknown := [stream for stream in topics if stream not in KINDS]:
            raise InputError(f"{unknown[0]!r}, expected {', '.join(KINDS)}", file=bag.path, field="topics")
        named = {stream: self._named(stream, names) for stream, names in topics.items() if names}
        left = {stream for stream, names in topics.items() if not names}
        self.manifest = read_manifest(bag)
        written = self.manifest.streams if self.manifest is not None else ()
        is_computed = self.manifest is not None and "odometry" not in written

        def candidates(stream: str) -> list[Topic]:
            return [] if stream in left else named.get(stream) or bag.of_kind(*KINDS[stream])

        known = {topic.name for topic in bag.of_kind(*KINDS["lidar"])}
        if strange := [topic for topic in self.mounts if topic not in known]:
            raise InputError(f"no lidar {strange[0]!r}", file=self.given.file, field="lidars")
        lidars = named.get("lidar") or ([] if "lidar" in left else self._best_lidar())
        self.lidars = [Table(one, figures_of, 7) for one in lidars]
        topic = lidars[0].name if lidars else ""
        imus = sorted(candidates("imu"), key=lambda one: not beside(one.name, topic))
        if imus:
            left_aside(bag, "imu", imus[0], [] if "imu" in named else imus[1:])
        self.imu = Table(imus[0], rates_of, 6) if imus else None
        joints = candidates("encoders")[:1] if "encoders" in named or "encoders" in written else []
        self.joints = Joints()
        self.encoders = Table(joints[0], self.joints, 4) if joints else None
        single = {stream: found[0] for stream, found in named.items() if stream != "lidar"}
        images = None if {"rgb", "depth"} & left else image_topics(bag, single)
        self.images = None if images is None else (Table(images[0]), Table(images[1]))
        odometry = [] if is_computed and "odometry" not in named else candidates("odometry")[:MAX_CANDIDATES]
        odometries = [Table(one, pose_of, 7) for one in odometry]
        self.frames = Frames()
        self._fill([*self._tables(None), *odometries], topic)
        frame = self.lidars[0].frame() if self.lidars else ""
        self.odometry: Table | None = odometries[0] if "odometry" in named else None
        if self.odometry is None:
            self.odometry = choose_odometry(bag, odometries, (topic, frame), self.frames)
        edge = self.frames.odometry_under(frame)
        self.base = (self.odometry.child if self.odometry else "") or (edge[0] if edge else self.frames.base())
        if self.odometry is None and edge is not None and not is_computed and "odometry" not in left:
            self.odometry = edge[1]
        bag.choose_session(self._tables(self.odometry), session)

    def _tables(self, odometry: Table | None) -> list[Table]:
        tables = [*self.lidars, odometry, self.imu, self.encoders, *(self.images or ())]
        return [table for table in tables if table is not None]

    def _named(self, stream: str, names: tuple[str, ...]) -> list[Topic]:
        names, field = (names,) if isinstance(names, str) else tuple(names), f"topics.{stream}"
        if len(names) > 1 and stream != "lidar":
            raise InputError(f"{len(names)} topics, expected one", file=self.bag.path, field=field)
        full = [name if name.startswith("/") else f"/{name}" for name in names]
        if len(set(full)) < len(full):
            raise InputError("a topic twice, expected each once", file=self.bag.path, field=field)
        usable = {topic.name: topic for topic in reversed(self.bag.of_kind(*KINDS[stream]))}
        if missing := [name for name in full if name not in usable]:
            kinds = " or ".join(kind.partition("/")[2] for kind in KINDS[stream])
            known = ", ".join(sorted(usable)[:20])
            expected = f"one of {known}" if usable else f"a topic of {kinds}, of which there is none"
            raise InputError(f"{missing[0]!r}, expected {expected}", file=self.bag.path, field=field)
        return [usable[name] for name in full]

    def _best_lidar(self) -> list[Topic]:
        topics = self.bag.of_kind(LASER_SCAN, MULTI_ECHO)
        if not topics:
            return []
        enough = [topic for topic in topics if topic.count >= MANY * topics[0].count]
        best = min(enough, key=lambda topic: any(word in topic.name.lower() for word in _NOT_LEVEL))
        left_aside(self.bag, "scans", best, [topic for topic in topics if topic is not best])
        return [best]

    def _fill(self, tables: list[Table], lidar: str) -> None:
        """Go through the bag: of several robots' transforms those in the lidar's namespace, and those in none."""

        def space(topic: str) -> list[str]:
            return topic.split("/")[1:-1][:1]

        transforms = self.bag.of_kind(*TRANSFORMS)
        if space(lidar) and any(space(topic.name) == space(lidar) for topic in transforms):
            transforms = [topic for topic in transforms if space(topic.name) in (space(lidar), [])]
        others = {topic: partial(self.frames.add, topic=topic) for topic in transforms}
        if broken := self.bag.fill({table.topic: table for table in tables}, others):
            self.bag.tell("broken-messages", "transforms", f"{counted(broken, 'broken message')} dropped", broken)

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
            streams["imu"] = imu_stream(bag, self.imu, self.frames, self.base)
        if bag.has(self.encoders):
            # by the wheels that they were written by, else by those that are given
            wheels = robot.wheels if self.manifest is None else self.manifest.platform.wheels
            if wheels is None:
                problem = "joints of wheels, expected a platform with [wheels] to count them by"
                raise InputError(problem, file=path, field=self.encoders.topic.name)
            streams["encoders"] = self.joints.encoder_stream(bag, self.encoders, wheels)
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
        if not scans:
            return None, Mount()
        if len(scans) == 1:
            return scans[0], self._mount(scans[0])
        return merged_scans(self.bag.path, scans, [self._mount(one) for one in scans]), Mount()

    def _mount(self, scans: Scans) -> Mount:
        """Where a lidar stands by the transforms; where a caller says it, these matter only for which way is up."""
        given, alone = self.mounts.get(scans.topic), len(self.lidars) == 1
        keys = self.given.lidar_figures.keys() if alone else set()
        is_given = given is not None or (alone and self.given.platform is not None) or {"x", "y", "yaw"} <= keys
        told = len(self.bag.issues)
        try:
            mount = self.frames.lidar_mount(self.bag, scans.topic, scans.frame, self.base)
        except InputError:
            if not is_given:
                raise
            mount = Mount()
        if is_given:
            del self.bag.issues[told:]
        if given is None:
            return mount
        return Mount(given.x, given.y, given.z, given.yaw, mount.upside_down)

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
