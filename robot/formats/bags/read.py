"""A recording from a bag: its topics are chosen, gone through once, and made into streams."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pydantic import ValidationError

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.choice import JOINT_STATE, POINT_CLOUD, TRANSFORMS, Chosen, choose, is_readable
from moteslam.robot.formats.bags.clouds import cloud_reader, cloud_scans
from moteslam.robot.formats.bags.heads import HEAD, HeadReader
from moteslam.robot.formats.bags.images import camera_mount, image_reader, image_topics, rgbd_stream
from moteslam.robot.formats.bags.manifest import read_manifest
from moteslam.robot.formats.bags.merged import merged_scans
from moteslam.robot.formats.bags.motion import (
    child_frame,
    imu_reader,
    imu_stream,
    odometry_of_messages,
    odometry_of_transforms,
    odometry_reader,
)
from moteslam.robot.formats.bags.mount import Mount, lidar_mount
from moteslam.robot.formats.bags.progress import Progress
from moteslam.robot.formats.bags.scans import Fan, Scans, laser_scans, scan_reader
from moteslam.robot.formats.bags.wheels import JointReader, encoder_stream
from moteslam.robot.formats.bounds import check_figures
from moteslam.robot.formats.format import Robot, Topics
from moteslam.robot.given_robot import GivenRobot
from moteslam.robot.issues import Issue
from moteslam.robot.platform import Platform
from moteslam.robot.ranges import CHUNK, ChunkedRanges
from moteslam.robot.recording import EncoderStream, LidarStream, OdometryStream, Recording, RgbdStream
from moteslam.robot.specs import CameraSpec, LidarSpec
from moteslam.robot.tables import Table
from moteslam.robot.wording import counted, first_complaint

IMAGE_HEAD = 256
"""Bytes of an image that are read for its stamp."""

MAX_JOINTS = 1 << 20
"""Bytes of a message of joints."""


def read_bag(
    path: str | PathLike[str],
    *,
    platform: Robot = None,
    topics: Topics | None = None,
) -> Recording:
    """Read a ROS bag: a ROS 1 ``.bag``, a ROS 2 folder, or a single ``.db3`` or ``.mcap`` file.

    Only headers are read here: ranges and images are read from the bag again whenever they are asked for.

    Args:
        path: of the file or folder.
        platform: the robot, or a ``platform.toml`` whose keys override what the bag's transforms give.
        topics: by stream, the topics to read it from; several lidars are merged into one fan. By their types where a
            stream is left out.

    Returns:
        a recording with the streams that the bag has; ``warnings`` lists what was dropped, repaired or left aside.

    Raises:
        InputError: no bag, a damaged one, no stream in it, a topic that is not there, or messages that are broken.
        ConfigError: a ``platform.toml`` that is none.
    """
    bag = Bag(Path(path))
    issues = list(bag.issues)
    chosen = choose(bag, topics or {}, issues)
    recording = BagReading(bag, chosen, GivenRobot.read(platform), issues).recording()
    bag.forget_index()
    return recording


class BagReading:
    """What is read of a bag, between its topics and its streams.

    Args:
        bag: to read.
        chosen: which topics.
        given: the robot, as far as the caller gives it.
        issues: found on the way; those of the streams are added.
        progress: what was read of the same bag before; nothing if None.
        chunk: scans whose ranges are read at a time.
    """

    def __init__(
        self,
        bag: Bag,
        chosen: Chosen,
        given: GivenRobot,
        issues: list[Issue],
        *,
        progress: Progress | None = None,
        chunk: int = CHUNK,
    ) -> None:
        self.bag, self.chosen, self.given, self.issues, self.chunk = bag, chosen, given, issues, chunk
        progress = progress or Progress()
        self.manifest = read_manifest(bag)
        if self._odometry_is_computed:
            self.chosen = replace(chosen, odometry=None)
        self.images = image_topics(bag, chosen, issues)
        self.encoders = chosen.encoders if self.manifest is None else self._written_wheels()

        def head(key: str, topic: Topic, make: Callable[..., HeadReader], at_most: int = HEAD) -> HeadReader:
            return progress.reader(key, topic, at_most, partial(make, topic, ros1=bag.ros1))

        self.scans = [
            head("scans", topic, cloud_reader if topic.kind == POINT_CLOUD else scan_reader) for topic in chosen.lidar
        ]
        self.image_heads = [head("images", topic, image_reader, IMAGE_HEAD) for topic in self.images or ()]
        topic = self.chosen.odometry
        self.odometry = None if topic is None else head("odometry", topic, odometry_reader)
        self.imu = None if chosen.imu is None else head("imu", chosen.imu, imu_reader)
        self.joints: JointReader | None = None
        if self.encoders is not None:
            make = partial(JointReader, len(self.encoders), ros1=bag.ros1)
            self.joints = progress.reader("encoders", self.encoders, MAX_JOINTS, make)
        self.transforms = progress.transforms(
            [topic for topic in bag.of_kind(*TRANSFORMS) if is_readable(topic)], ros1=bag.ros1
        )
        progress.go_on(bag)
        if broken := self.transforms.broken:
            text = f"{bag.path.name}: transforms: {counted(broken, 'broken message')} dropped"
            issues.append(Issue("broken-messages", text, broken))
        self.tree = self.transforms.tree()
        self.base = self._base()

    @property
    def is_empty(self) -> bool:
        """Whether there is nothing yet that streams are made of."""
        edge = None if self._odometry_is_computed else self.transforms.odometry()
        return all(found is None for found in (*self.scans, self.odometry, self.imu, self.joints, edge))

    @property
    def _odometry_is_computed(self) -> bool:
        """Whether the bag's odometry was computed by this package, for those who play the bag: it is no stream."""
        return self.manifest is not None and "odometry" not in self.manifest.streams

    def _written_wheels(self) -> Topic | None:
        """The wheels of a bag that this package wrote, or those that are named."""
        if self.chosen.encoders is not None or self.manifest is None or "encoders" not in self.manifest.streams:
            return self.chosen.encoders
        return next((topic for topic in self.bag.of_kind(JOINT_STATE) if is_readable(topic)), None)

    def _base(self) -> str | None:
        """The robot's frame: that of its odometry, else by the usual names."""
        if self.odometry and (frame := child_frame(self.odometry.heads())):
            return frame
        edge = self.transforms.odometry()
        return edge.child if edge is not None else self.tree.base()

    def recording(self) -> Recording:
        """The streams, on the robot."""
        scans, mount = self._scans_and_mount()
        camera = camera_mount(self.image_heads[1], self.tree, self.base) if self.images else None
        robot = self.given.platform or self.given.over(self._stated(scans, mount, camera))
        lidar = self._lidar(scans, mount, robot) if scans is not None else None
        odometry, imu = self._odometry_stream(), None
        if self.chosen.imu is not None and self.imu is not None:
            imu = imu_stream(self.bag, self.chosen.imu, self.imu.heads(), self.tree, self.base, self.issues)
        encoders = self._encoder_stream(robot)
        if lidar is None and odometry is None and imu is None and encoders is None:
            kinds = ", ".join(sorted({topic.kind[:60] for topic in self.bag.topics})[:8]) or "no topics"
            raise InputError(f"{kinds}: expected scans, odometry or an IMU", file=self.bag.path)
        return Recording(
            name=self.bag.path.resolve().name.removesuffix(self.bag.path.suffix),
            platform=robot,
            lidar=lidar,
            encoders=encoders,
            odometry=odometry,
            imu=imu,
            rgbd=self._rgbd(robot),
            warnings=tuple(self.issues),
        )

    def _scans_and_mount(self) -> tuple[Scans | None, Mount]:
        """The scans of the lidar, or of several as one about the robot's centre, and where it stands."""
        path, scans = self.bag.path, []
        for topic, reader in zip(self.chosen.lidar, self.scans, strict=True):
            read = cloud_scans if topic.kind == POINT_CLOUD else laser_scans
            scans.append(read(self.bag, topic, reader, self.issues))
        if not scans:
            return None, Mount()
        if len(scans) == 1:
            return scans[0], self._mount(scans[0])
        mounts = [lidar_mount(path, one.topic, one.frame, self.tree, self.base, self.issues) for one in scans]
        return merged_scans(path, scans, mounts), Mount()

    def _mount(self, scans: Scans) -> Mount:
        """Where a lidar stands by the transforms; where a caller says it, these matter only for which way is up."""
        is_given = self.given.platform is not None or {"x", "y", "yaw"} <= self.given.lidar_figures.keys()
        issues: list[Issue] = [] if is_given else self.issues
        try:
            return lidar_mount(self.bag.path, scans.topic, scans.frame, self.tree, self.base, issues)
        except InputError:
            if is_given:
                return Mount()
            raise

    def _stated(self, scans: Scans | None, mount: Mount, camera: CameraSpec | None) -> Platform:
        """The robot that the bag states: of one that this package wrote, the whole; else where its sensors stand."""
        if self.manifest is not None:
            return self.manifest.platform
        if scans is None:
            return Platform(camera=camera)
        try:
            step = scans.fan.time_increment
            spec = LidarSpec(x=mount.x, y=mount.y, z=mount.z, yaw=mount.yaw, time_increment=step)
        except ValidationError as error:
            field, problem = first_complaint(error, "robot", lambda place: "")
            raise InputError(problem, file=self.bag.path, field=f"{scans.topic}: {field}") from error
        return Platform(lidar=spec, camera=camera)

    def _rgbd(self, robot: Platform) -> RgbdStream | None:
        """The images, where it is known where the camera stands."""
        if self.images is None:
            return None
        if robot.camera is None:
            text = f"{self.bag.path.name}: images left out: no transform to the frame of {self.images[1].name}"
            self.issues.append(Issue("images-left", text, 2))
            return None
        colour, depth = self.image_heads
        return rgbd_stream(self.bag, self.images, (colour, depth), self.issues)

    def _lidar(self, scans: Scans, mount: Mount, robot: Platform) -> LidarStream:
        fan = self.manifest.sharpened(scans.fan) if self.manifest is not None else scans.fan
        fan = _given_over(fan.flipped() if mount.upside_down else fan, self.given.lidar_figures, self.bag.path)

        def load(first: int, last: int) -> NDArray[np.float32]:
            return scans.cleaned(np.arange(first, last), fan)

        return LidarStream(
            stamps=scans.stamps,
            ranges=ChunkedRanges(load, len(scans.stamps), fan.beams, chunk=self.chunk),
            angle_min=fan.angle_min,
            angle_increment=fan.angle_increment,
            range_min=fan.range_min,
            range_max=fan.range_max,
            time_increment=robot.lidar.time_increment,
        )

    def _encoder_stream(self, robot: Platform) -> EncoderStream | None:
        """The counters of the wheels, where their topic is named or known, on a robot with wheels.

        Raises:
            InputError: they are named, but the robot has no wheels.
        """
        if self.encoders is None or self.joints is None:
            return None
        wheels = robot.wheels if self.manifest is None else self.manifest.platform.wheels  # that they were written by
        if wheels is None:
            problem = "joints of wheels, expected a platform with [wheels] to count them by"
            raise InputError(problem, file=self.bag.path, field=self.encoders.name)
        return encoder_stream(self.bag, self.encoders, self.joints, wheels, self.issues)

    def _odometry_stream(self) -> OdometryStream | None:
        if self._odometry_is_computed:
            return None
        if self.chosen.odometry is not None and self.odometry is not None:
            return odometry_of_messages(self.bag, self.chosen.odometry, self.odometry.heads(), self.issues)
        edge = self.transforms.odometry()
        return odometry_of_transforms(self.bag.path, edge, self.issues) if edge is not None else None


def _given_over(fan: Fan, given: Table, path: Path) -> Fan:
    """The fan with the figures that a caller's ``platform.toml`` puts in place of the messages'.

    Raises:
        InputError: they do not fit the scans.
    """
    names = ("angle_min", "angle_increment", "range_min", "range_max")
    changed = Fan(**{**vars(fan), **{name: given[name] for name in names if name in given}})
    check_figures(changed.beams, changed.angle_increment, changed.range_min, changed.range_max, file=path)
    return changed
