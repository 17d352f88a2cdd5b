"""Which topics of a bag the streams are read from: those that are named, else by the types of their messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from moteslam.errors import InputError
from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.motion import IMU, ODOMETRY, left_aside
from moteslam.robot.formats.bags.scans import LASER_SCAN, MULTI_ECHO
from moteslam.robot.formats.format import Topics
from moteslam.robot.issues import Issue

POINT_CLOUD, JOINT_STATE = "sensor_msgs/PointCloud2", "sensor_msgs/JointState"
IMAGE, COMPRESSED_IMAGE, CAMERA_INFO = "sensor_msgs/Image", "sensor_msgs/CompressedImage", "sensor_msgs/CameraInfo"
TRANSFORMS = ("tf2_msgs/TFMessage", "tf/tfMessage")

KINDS: Mapping[str, tuple[str, ...]] = {
    "lidar": (LASER_SCAN, MULTI_ECHO, POINT_CLOUD),
    "odometry": (ODOMETRY,),
    "imu": (IMU,),
    "encoders": (JOINT_STATE,),
    "rgb": (COMPRESSED_IMAGE, IMAGE),
    "depth": (COMPRESSED_IMAGE, IMAGE),
}
"""By stream, the types that it can be read from."""

DIGESTS: Mapping[str, str] = {
    LASER_SCAN: "90c7ef2dc6895d81024acba2ac42f369",
    MULTI_ECHO: "6fefb0c6da89d7c8abe4b339f5c2f8fb",
    POINT_CLOUD: "1158d486dd51d683ce2f1be655c3c181",
    ODOMETRY: "cd5e73d190d741a2f92e81eda573aca7",
    IMU: "6a62c6daae103f4ff57a132d6f95cec2",
    JOINT_STATE: "3066dcd76a6cfaef579bd0f34173e9fd",
    IMAGE: "060021388200f6f0f447d0fcd9c64743",
    COMPRESSED_IMAGE: "8f7a12909da2c9d3332d540a0977563f",
    CAMERA_INFO: "c9a58c1b0b154e0e6da7578cb991d214",
    "tf2_msgs/TFMessage": "94810edda583a504dfda3829e70d7eec",
    "tf/tfMessage": "94810edda583a504dfda3829e70d7eec",
    "std_msgs/String": "992ce8a1687cec8c8bd883ec73ca41d1",
}
"""MD5 sums of the definitions that are read, as ROS 1 states them; other types of the same name are left alone."""

MANY = 0.75
"""A lidar with this share of the most scans competes with it."""

_NOT_LEVEL = ("vertical", "tilt", "nod")
"""In the name of a topic or frame of a lidar that does not scan the plane of the floor."""


@dataclass(frozen=True)
class Chosen:
    """The topics that streams are read from; empty or None where there is none.

    Attributes:
        lidar: one, or several that are merged.
        odometry, imu, encoders, rgb, depth: of these streams.
    """

    lidar: tuple[Topic, ...] = ()
    odometry: Topic | None = None
    imu: Topic | None = None
    encoders: Topic | None = None
    rgb: Topic | None = None
    depth: Topic | None = None


def choose(bag: Bag, named: Topics, issues: list[Issue]) -> Chosen:
    """The topics to read.

    Of several with a type the one with most messages is read, and an issue names the others. Of lidars with nearly as
    many scans, one whose topic is called vertical or tilted comes last. Point clouds are read where there are no
    scans. Wheels and images are read where they are named.

    Args:
        bag: to read.
        named: by stream, its topics.
        issues: topics that are left aside are added.

    Raises:
        InputError: a stream that is none, or a topic that is not there, or of another type.
    """
    _leave_other_definitions(bag, issues)
    if unknown := [stream for stream in named if stream not in KINDS]:
        problem = f"{unknown[0]!r}, expected {', '.join(KINDS)}"
        raise InputError(problem, file=bag.path, field="topics")
    found = {stream: _named(bag, stream, names) for stream, names in named.items()}
    lidar = found.get("lidar") or _lidar(bag, issues)
    single = {stream: topics[0] for stream, topics in found.items() if stream != "lidar"}
    for stream in ("odometry", "imu"):
        if stream not in single and (topics := _readable(bag, *KINDS[stream])):
            single[stream] = topics[0]
            left_aside(bag.path, stream, topics[0], topics[1:], issues)
    return Chosen(tuple(lidar), **single)


def _readable(bag: Bag, *kinds: str) -> list[Topic]:
    """The topics of some types with messages, by the definition that is read here."""
    return [topic for topic in bag.of_kind(*kinds) if is_readable(topic)]


def is_readable(topic: Topic) -> bool:
    """Whether a topic's messages are of the definition that is read here, as far as the bag says."""
    return topic.digest in ("", "*", DIGESTS.get(topic.kind))


def _leave_other_definitions(bag: Bag, issues: list[Issue]) -> None:
    for topic in bag.of_kind(*DIGESTS):
        if not is_readable(topic):
            text = f"{bag.path.name}: {topic.name}: {topic.kind} by another definition than the usual one, left aside"
            issues.append(Issue("other-definition", text, len(topic)))


def _named(bag: Bag, stream: str, names: tuple[str, ...]) -> list[Topic]:
    names = (names,) if isinstance(names, str) else tuple(names)
    if not names or (len(names) > 1 and stream != "lidar"):
        problem = f"{len(names)} topics, expected {'one or more' if stream == 'lidar' else 'one'}"
        raise InputError(problem, file=bag.path, field=f"topics.{stream}")
    full = [name if name.startswith("/") else f"/{name}" for name in names]
    if len(set(full)) < len(full):
        raise InputError("a topic twice, expected each once", file=bag.path, field=f"topics.{stream}")
    usable = {topic.name: topic for topic in reversed(_readable(bag, *KINDS[stream]))}
    if missing := [name for name in full if name not in usable]:
        kinds = " or ".join(kind.partition("/")[2] for kind in KINDS[stream])
        known = f"one of {', '.join(sorted(usable)[:20])}" if usable else f"a topic of {kinds}, of which there is none"
        raise InputError(f"{missing[0]!r}, expected {known}", file=bag.path, field=f"topics.{stream}")
    return [usable[name] for name in full]


def _lidar(bag: Bag, issues: list[Issue]) -> list[Topic]:
    topics = _readable(bag, LASER_SCAN, MULTI_ECHO) or _readable(bag, POINT_CLOUD)
    if not topics:
        return []
    enough = [topic for topic in topics if len(topic) >= MANY * len(topics[0])]
    best = min(enough, key=lambda topic: any(word in topic.name.lower() for word in _NOT_LEVEL))
    left_aside(bag.path, "scans", best, [topic for topic in topics if topic is not best], issues)
    return [best]
