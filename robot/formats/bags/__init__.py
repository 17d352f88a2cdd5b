"""ROS bags: a recording from one, its topics chosen, gone through once and made into streams."""

import re
import tomllib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import Format, Robot, Topics
from moteslam.robot.formats.bags import motion, scans, write
from moteslam.robot.formats.bags.bag import Bag, Table, is_bag
from moteslam.robot.formats.bags.definitions import is_readable
from moteslam.robot.formats.bags.storage import Topic
from moteslam.robot.formats.streams import Fan
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.platforms import GivenRobot, platform_of
from moteslam.robot.recording import ChunkedRanges, LidarStream, Recording
from moteslam.robot.values import Issue, counted, validated

KINDS: Mapping[str, tuple[str, Callable[[Any], tuple[float, ...]], int]] = {
    scans.LASER_SCAN: ("lidar", scans.figures_of, 7),
    scans.MULTI_ECHO: ("lidar", scans.figures_of, 7),
    motion.ODOMETRY: ("odometry", motion.pose_of, 8),
    motion.IMU: ("imu", motion.RATES, 6),
    motion.JOINT_STATE: ("encoders", motion.wheel_angles, 4),
    write.COMPRESSED_IMAGE: ("rgbd", lambda _: (), 0),
}
"""By type, the stream that is read from its messages, what is kept of each, and how many numbers that are."""
_STREAMS = dict.fromkeys(stream for stream, _, _ in KINDS.values())

MANY = 0.75  # A lidar with this share of the most scans competes with it
_NOT_LEVEL = ("vertical", "tilt", "nod")  # In the name of a topic of a lidar that does not scan the plane of the floor

_TRUTH = re.compile(r"(^|[^a-z])([a-z]*truth|true|gt|p3d|model_states?|mocap|vicon|vrpn|optitrack)([^a-z]|$)")
"""In the name of a topic or frame that holds where the robot truly was: of simulators, and of cameras in a hall."""
_WORLD = {"world", "map"}  # frames in which no wheel measures
MAX_LETTERS = 1 << 20


def read_bag(
    path: str | PathLike[str], sequence: str | int | None = None, platform: Robot = None, topics: Topics | None = None
) -> Recording:
    """Read a ROS bag: a ROS 1 ``.bag``, a ROS 2 folder, or a single ``.db3`` or ``.mcap`` file.

    Only headers are read here: ranges and images are read from the bag again whenever they are asked for. A table
    ``[lidars."/topic"]`` in the file of a platform gives the mount of one of several lidars. A stream of no topics is
    not read; one that ``topics`` leaves out is read by its types.
    """
    return _Reading(Bag(Path(path)), GivenRobot.read(platform), topics or {}, sequence).recording()


class Manifest(BaseModel):
    """What a bag says about the recording that it was written from: its streams, robot and figures of the scans."""

    streams: tuple[str, ...]
    platform: Platform
    scan: dict[str, float]

    def sharpened(self, fan: Fan) -> Fan:
        """The fan with the figures that the messages round, wherever they round to those of the messages."""
        figures: Any = {name: self.scan[name] for name in write.FIGURES if name in self.scan}
        rounded = {name: np.float32(value) == np.float32(getattr(fan, name)) for name, value in figures.items()}
        return fan._replace(**{name: value for name, value in figures.items() if rounded[name]})


class _Reading:
    """A bag between its topics and its streams.

    Of several topics with a type the one with most messages is read, and an issue names the others. Wheels are read if
    they are named, or in a bag that this package wrote, and images only of such a bag: others are of another camera.
    """

    def __init__(self, bag: Bag, given: GivenRobot, topics: Topics, session: str | int | None) -> None:
        self.bag, self.frames = bag, motion.Frames(bag)
        self.given, self.mounts = given.lidars()
        named = {stream: (names,) if isinstance(names, str) else names for stream, names in topics.items()}
        self.named = {stream: [f"/{name.removeprefix('/')}" for name in names] for stream, names in named.items()}
        self.is_ours = False
        self.manifest: Manifest | None = None
        tables = bag.fill(self._table_of)
        self.tables = [table for table in tables if is_readable(table.topic)]
        for table in tables:
            what = f"{counted(table.broken, 'message')} of {table.topic.kind}"
            if table not in self.tables:
                bag.tell("other-definition", table.topic, f"{what} by another definition: left aside", table.broken)
            elif table.broken and table.topic.kind not in KINDS:
                bag.tell("broken-messages", table.topic, f"{what} broken: dropped", table.broken)
        self._expect_named()
        written = self.manifest.streams if self.manifest is not None else ()
        is_computed = self.manifest is not None and "odometry" not in written
        self.lidars = self._of("lidar") if "lidar" in self.named else self._best_lidar()
        topic, frame = (self.lidars[0].topic.name, self.lidars[0].frame) if self.lidars else ("", "")
        imus = sorted(self._of("imu"), key=lambda table: not beside(table.topic.name, topic))
        self.imu = next(iter(imus), None)
        left_aside(bag, "imu", imus)
        self.encoders = next(iter(self._of("encoders")), None)
        self.images = [table for name in write.IMAGES for table in self._of("rgbd") if table.topic.name == name]
        others = sorted(one.name for one in bag.topics if one.kind in write.IMAGE_KINDS)
        if others and "rgbd" not in self.named and self.manifest is None:
            bag.tell("images-left", ", ".join(others[:4]), "images of other programs: left out", len(others))
        self.frames.keep(motion.namespace(topic))
        odometry = [] if is_computed and "odometry" not in self.named else self._of("odometry")
        if not self.named.get("odometry"):
            odometry = choose_odometry(odometry, topic, frame, self.frames)
        edges = self.frames.odometry_under(frame)
        self.odometry = next(iter(odometry), None)
        self.base = (self.odometry.child if self.odometry else "") or (edges[0].child if edges else self.frames.base())
        if self.odometry is None and not is_computed and "odometry" not in self.named:
            self.odometry = next(iter(edges), None)
            left_aside(bag, "odometry", edges)
        joints = sorted(topic.name for topic in bag.topics if topic.kind == motion.JOINT_STATE)
        if joints and self.odometry is None and self.encoders is None:
            bag.tell("no-odometry", joints[0], "left out: --topics encoders=TOPIC reads it, if the robot has [wheels]")
        used = [*self.lidars, self.odometry, self.imu, self.encoders, *self.images]
        bag.choose_session([table for table in used if table is not None], session)

    def _expect_named(self) -> None:
        """Refuse streams that are none, and topics that are not there."""
        streams = [(KINDS[topic.kind][0], topic.name) for topic in sorted(self.bag.topics) if topic.kind in KINDS]
        known = {stream: [name for of, name in streams if of == stream] for stream in _STREAMS}
        for stream, names in self.named.items():
            if stream not in known:
                raise InputError(f"{stream!r}, expected {', '.join(known)}", file=self.bag.path, field="topics")
            if len(self._of(stream)) < len(names) or (len(names) > 1 and stream != "lidar"):
                expected = f"{'some' if stream == 'lidar' else 'one'} of {', '.join(known[stream][:20]) or 'none'}"
                problem = f"{', '.join(names)}: expected {expected}"
                raise InputError(problem, file=self.bag.path, field=f"topics.{stream}")
        if strange := [topic for topic in self.mounts if topic not in known["lidar"]]:
            raise InputError(f"no lidar {strange[0]!r}", file=self.given.file, field="lidars")

    def _table_of(self, topic: Topic) -> Table | None:
        """The table of a topic of which something is used, or may be."""
        if topic.encoding not in ("cdr", "ros1"):
            return None
        if topic.kind in motion.TRANSFORMS:
            return Table(topic, partial(self.frames.add, topic=topic))
        if topic[:2] == write.MANIFEST:
            self.is_ours = True
            return Table(topic, self._read_manifest)
        stream, take, width = KINDS.get(topic.kind, ("", None, 0))
        is_read = stream in ("lidar", "odometry", "imu", *(_STREAMS if self.is_ours else self.named))
        is_read &= topic.name in self.named.get(stream, (topic.name,))
        return Table(topic, take, width) if take is not None and is_read else None

    def _read_manifest(self, message: Any) -> tuple[float, ...]:
        try:
            if len(message.data) > MAX_LETTERS:
                raise ValueError(f"{len(message.data)} letters")
            self.manifest = self.manifest or validated(Manifest, tomllib.loads(message.data))
        except (ValueError, RecursionError, ConfigError) as error:
            problem = f"{' '.join(str(error).split())[:200]}, expected the description of a recording"
            raise InputError(problem, file=self.bag.path, field=write.MANIFEST[0]) from error
        return ()

    def _of(self, stream: str) -> list[Table]:
        """The tables that a stream can be read from: those named, in their order, else all, those with most first."""
        found = [table for table in self.tables if KINDS.get(table.topic.kind, ("",))[0] == stream]
        names = self.named.get(stream, [])
        return [table for name in names for table in found if table.topic.name == name] if names else found

    def _best_lidar(self) -> list[Table]:
        tables = self._of("lidar")
        few = [table for table in tables if table.count < MANY * tables[0].count]
        tables.sort(key=lambda table: (table in few, any(word in table.topic.name.lower() for word in _NOT_LEVEL)))
        left_aside(self.bag, "scans", tables)
        return tables[:1]

    def recording(self) -> Recording:
        bag = self.bag
        placed = [self._placed(table) for table in self.lidars]
        lidar, mount = placed[0] if placed else (None, LidarSpec())
        streams: dict[str, Any] = {}
        if len(placed) > 1:  # one fan about the robot's centre
            driven = None if self.odometry is None else lambda *at: motion.driven(streams.get("odometry"), *at)
            lidar, mount = scans.merged_scans(bag, placed, driven), LidarSpec()
        robot = self.given.platform or self.given.over(self._stated(lidar, mount))
        streams["lidar"] = None if lidar is None else self._lidar(lidar, robot)
        wheels = robot if self.manifest is None else self.manifest.platform  # that were counted by, else those given
        for name, table, read in (
            ("odometry", self.odometry, partial(motion.odometry_stream, bag)),
            ("imu", self.imu, partial(motion.imu_stream, self.frames, self.base)),
            ("encoders", self.encoders, partial(motion.encoder_stream, bag, wheels)),
        ):
            if table is not None and len(table) and not len(table.rows):
                bag.tell("sessions", table.topic, "no message in the session that is read")
            elif table is not None:
                streams[name] = read(table)
        if all(stream is None for stream in streams.values()):
            kinds = ", ".join(sorted({topic.kind[:60] for topic in bag.topics})[:8]) or "no topics"
            raise InputError(f"{kinds}: expected LaserScan, Odometry or Imu", file=bag.path)
        if len(self.images) == 2 and robot.camera is not None:
            streams["rgbd"] = scans.rgbd_stream(bag, *self.images)
        name = bag.path.resolve().name.removesuffix(bag.path.suffix)
        return Recording(name=name, platform=robot, warnings=tuple(bag.issues), **streams)

    def _placed(self, table: Table) -> tuple[scans.Scans, LidarSpec]:
        """The scans of a lidar, and where it stands by the transforms, which say what is up, or as a caller says."""
        if table.others:
            frames = ", ".join(sorted({table.frame, *table.others})[:4])
            problem = f"scans in several frames ({frames}), expected those of one lidar, each on a topic of its own"
            raise InputError(problem, file=self.bag.path, field=table.topic.name)
        given, is_given = self.mounts.get(table.topic.name), table.topic.name in self.mounts
        if len(self.lidars) == 1:
            is_given |= self.given.platform is not None or {"x", "y", "yaw"} <= self.given.lidar_figures.keys()
        lidar = scans.laser_scans(self.bag, table)
        mount, is_upside_down = self.frames.lidar_mount(lidar.topic, table.frame, self.base, is_given=is_given)
        if is_upside_down:
            lidar = replace(lidar, fan=lidar.fan.flipped())
        return lidar, mount if given is None else given

    def _stated(self, lidar: scans.Scans | None, mount: LidarSpec) -> Platform:
        """The robot that the bag states: of one that this package wrote, the whole; else where its lidar stands."""
        if self.manifest is not None:
            return self.manifest.platform
        table = {} if lidar is None else {"lidar": {**mount.model_dump(), "time_increment": lidar.fan.time_increment}}
        return platform_of(table, file=self.bag.path)

    def _lidar(self, lidar: scans.Scans, robot: Platform) -> LidarStream:
        fan = self.manifest.sharpened(lidar.fan) if self.manifest is not None else lidar.fan
        fan = fan.over(self.given.lidar_figures, fan.beams, file=self.bag.path, field=f"{lidar.topic}: angle_increment")
        ranges = ChunkedRanges(lambda a, b: lidar.cleaned(np.arange(a, b), fan), len(lidar.stamps), fan.beams)
        return LidarStream(lidar.stamps, ranges, *fan[:4], robot.lidar.time_increment)


def choose_odometry(tables: Sequence[Table], topic: str, frame: str, frames: motion.Frames) -> list[Table]:
    """The odometry where none is named: of the robot of the lidar's topic and frame, never where it truly was."""

    def is_truth(table: Table) -> bool:
        named = f"{table.topic.name} {table.child} {table.frame}".lower()
        return table.frame.rpartition("/")[2].lower() in _WORLD or _TRUTH.search(named) is not None

    def is_other_robots(table: Table) -> bool:
        apart = table.child in frames and frame in frames and frames.place(frame, table.child) is None
        return apart and not (table.child in motion.BASES and any(frames.place(frame, base) for base in motion.BASES))

    def rank(table: Table) -> tuple[bool, bool, bool, bool, int]:
        is_odom = table.frame.rpartition("/")[2].startswith("odom")
        carries = frames.place(frame, table.child) is not None
        is_uncertain = bool(table.values[:, 7].any())  # what is measured is; a simulator's truth has no covariance
        return carries, beside(table.topic.name, topic), is_odom, is_uncertain, len(table)

    truth = [table for table in tables if is_truth(table)]
    others = [table for table in tables if table not in truth and is_other_robots(table)]
    for code, left, what in (
        ("truth-left", truth, "where the robot truly was, or an estimate in a map; not used unless --topics names it"),
        ("other-robot", others, f"of a robot that does not carry the lidar's frame {frame}; left aside"),
    ):
        if left:
            names = ", ".join(f"{table.topic.name} (in {table.frame or 'no frame'})" for table in left[:4])
            frames.bag.tell(code, names, what, len(left))
    candidates = [table for table in tables if table not in truth and table not in others]
    candidates.sort(key=rank, reverse=True)
    if candidates and not beside(name := candidates[0].topic.name, topic):
        frames.bag.tell("other-robot", name, f"used, but of another namespace than {topic}: is it of another robot?")
    left_aside(frames.bag, "odometry", candidates)
    return candidates[:1]


def beside(topic: str, lidar: str) -> bool:
    """Whether a topic is in the namespace of the lidar's, or one of the two is in none."""
    ours, theirs = motion.namespace(topic), motion.namespace(lidar)
    return not ours or not theirs or ours == theirs


def left_aside(bag: Bag, what: str, tables: Sequence[Table]) -> None:
    """Name the topics of a kind that are not used: all but the first."""
    names = [f"{table.topic.name} ({counted(table.count, 'message')})" for table in tables[:9]]
    if len(names) > 1:
        text = f"{bag.path.name}: {what} of {names[0]} used; left aside: {', '.join(names[1:])}"
        doubt = ". Is it where a simulator knows the robot to be, SLAM's errors mean nothing: name another by --topics"
        text += doubt if what == "odometry" else ""
        bag.issues.append(Issue("topics-left", text, len(tables) - 1))


def _format(name: str, kind: str, *endings: str) -> Format:
    write_it = None if kind == "db3" else partial(write.write_bag, kind=kind)
    return Format(name, kind == "rosbag2", partial(is_bag, kind=kind), read_bag, read_bag, write_it, endings)


ROSBAG1 = _format("ROS 1 bag", "bag", ".bag")
MCAP = _format("MCAP file of ROS", "mcap", ".mcap")
DB3 = _format("SQLite file of ROS 2", "db3")
ROSBAG2 = _format("ROS 2 bag (a folder with metadata.yaml)", "rosbag2")
