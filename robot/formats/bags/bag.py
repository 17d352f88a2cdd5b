"""A bag: the topics of its file, or of the files of its folder, and their messages in the order they were written."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.containers import MAX_MESSAGES
from moteslam.robot.formats.bags.folder import open_files
from moteslam.robot.values import Issue

SECOND = 1_000_000_000
"""Nanoseconds."""


@dataclass(frozen=True)
class Topic:
    """The messages of one topic and type.

    Attributes:
        name: with a leading slash.
        kind: the type, ``sensor_msgs/LaserScan``.
        digest: of the type's definition, where the bag states one, as ROS 1 does.
        count: of messages.
        channels: of it, each by the number of its file and its own.
    """

    name: str
    kind: str
    digest: str
    count: int
    channels: frozenset[tuple[int, int]]


@dataclass(eq=False)
class Table:
    """What is kept of the messages of a topic, in the order they were written; a broken one is counted alone.

    Attributes:
        topic: of them.
        take: gives the numbers that are kept of a message, ``width`` of them; raises a ValueError for a broken one.
        stamps: [n] of the headers [ns]; received: [n] when they came [ns]; order: [n] their number in the bag.
        places: [n * 3] where they lie; numbers: [n * width]; marks: [n] checksums; frames: [n] indices of ``names``.
        child: the child frame of an odometry.
        broken: how many were.
    """

    topic: Topic
    take: Callable[[Any], tuple[float, ...]]
    width: int
    stamps: array[int] = field(default_factory=lambda: array("q"))
    received: array[int] = field(default_factory=lambda: array("q"))
    order: array[int] = field(default_factory=lambda: array("q"))
    places: array[int] = field(default_factory=lambda: array("q"))
    numbers: array[float] = field(default_factory=lambda: array("d"))
    marks: array[int] = field(default_factory=lambda: array("q"))
    frames: array[int] = field(default_factory=lambda: array("i"))
    names: dict[str, int] = field(default_factory=dict)
    child: str = ""
    broken: int = 0

    @property
    def values(self) -> NDArray[np.float64]:
        """The numbers [n, width] of the messages."""
        return np.array(self.numbers).reshape(-1, self.width) if self.width else np.empty((len(self.stamps), 0))

    def frame(self, index: int = 0) -> str:
        """The frame of a message's header."""
        return list(self.names)[self.frames[index]] if len(self.frames) else ""


class Bag:
    """A bag; messages are read from its files whenever they are asked for.

    Raises:
        InputError: no bag, or one that is damaged.
    """

    def __init__(self, path: Path) -> None:
        self.path, self.issues = path, list[Issue]()
        self._containers = open_files(path, self.issues)
        if len({container.ros1 for container in self._containers}) > 1:
            raise InputError("files of ROS 1 and of ROS 2, expected one of them", file=path)
        self.ros1 = self._containers[0].ros1
        parts: dict[tuple[str, str, str], list[tuple[int, int, int]]] = {}
        for number, container in enumerate(self._containers):
            if container.damage:
                text = f"{container.path.name}: {container.damage}; what can be read is used"
                self.issues.append(Issue("damaged-bag", text))
            for channel in container.channels:
                name = channel.topic if channel.topic.startswith("/") else f"/{channel.topic}"
                key = (name[:4096], channel.kind[:4096], channel.digest)
                parts.setdefault(key, []).append((number, channel.number, channel.total))
        self.topics = [
            Topic(*key, sum(part[2] for part in found), frozenset(part[:2] for part in found))
            for key, found in parts.items()
        ]
        if (total := sum(topic.count for topic in self.topics)) > MAX_MESSAGES:
            raise InputError(f"{total} messages, expected at most {MAX_MESSAGES}", file=path)

    def of_kind(self, *kinds: str) -> list[Topic]:
        """The topics of these types that have messages and are read here, those with most first, then by name."""
        found = [topic for topic in self.topics if topic.kind in kinds and topic.count and self.is_readable(topic)]
        return sorted(found, key=lambda topic: (-topic.count, topic.name))

    def is_readable(self, topic: Topic) -> bool:
        """Whether a topic's messages are of the definition that is read here, as far as the bag says."""
        return topic.digest in ("", "*") or topic.digest == _digest(topic.kind)

    def sweep(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, tuple[int, int, int], bytes]]:
        """The messages of some topics: when they were received [ns], where they lie, and their bytes."""
        owner = {channel: topic for topic in topics for channel in topic.channels}
        for number, container in enumerate(self._containers):
            known = {channel[1]: topic for channel, topic in owner.items() if channel[0] == number}
            if known:
                for channel, received, place, data in container.messages(known.keys()):
                    yield known[channel], received, (number, *place), data

    def payloads(self, places: NDArray[np.int64]) -> Iterator[bytes]:
        """The messages at some places [n, 3]."""
        edges = [0, *(np.flatnonzero(np.diff(places[:, 0])) + 1).tolist(), len(places)]
        for first, last in pairwise(edges):
            if first < last:
                container = self._containers[int(places[first, 0])]
                yield from container.payloads([(row[1], row[2]) for row in places[first:last].tolist()])

    def decode(self, topic: Topic, data: bytes) -> Any:
        """A message.

        Raises:
            ValueError: it is not what its type says.
        """
        return decoder(ros1=self.ros1)(data, topic.kind)

    def fill(self, tables: Mapping[Topic, Table], others: Mapping[Topic, Callable[[Any, int], None]]) -> int:
        """Go through the bag once: every message of a table's topic is a row, those of the others are handed on.

        Returns:
            how many of the others' are broken.
        """
        broken = 0
        decode = decoder(ros1=self.ros1)
        for order, (topic, received, place, data) in enumerate(self.sweep([*tables, *others])):
            table = tables.get(topic)
            try:
                message = decode(data, topic.kind)
                if table is None:
                    others[topic](message, order)
                    continue
                numbers = table.take(message)
                header = message.header
                stamp = int(header.stamp.sec) * SECOND + int(header.stamp.nanosec)
                frame = table.names.setdefault(frame_name(header.frame_id), len(table.names))
                table.child = table.child or frame_name(getattr(message, "child_frame_id", ""))
            except ValueError:
                if table is None:
                    broken += 1
                else:
                    table.broken += 1
                continue
            table.stamps.append(stamp)
            table.received.append(received)
            table.order.append(order)
            table.places.extend(place)
            table.numbers.extend(numbers)
            table.marks.append(hash(data[4:4096]))  # behind what numbers the messages in ROS 1
            table.frames.append(frame)
        return broken


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of ROS before 2012."""
    return name.lstrip("/")


def full_name(kind: str) -> str:
    """The type's name as ROS 2 has it."""
    package, _, name = kind.partition("/")
    return f"{package}/msg/{name}"


@cache
def store(*, ros1: bool) -> Any:
    """The message definitions that rosbags brings for ROS 1 (Noetic) or ROS 2 (Humble), with those of tf."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    made = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
    for name in ("tf2_msgs/msg/TFMessage", "tf/msg/tfMessage"):
        if name not in made.types:
            made.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms\n", name))
    return made


@cache
def _digest(kind: str) -> str | None:
    known = store(ros1=True)
    return known.generate_msgdef(full_name(kind))[1] if full_name(kind) in known.types else None


@cache
def decoder(*, ros1: bool) -> Callable[[bytes, str], Any]:
    """What makes a message of bytes and its type.

    A message that is not what its type says is a ValueError, whatever rosbags stumbles over.
    """
    made = store(ros1=ros1)
    read = made.deserialize_ros1 if ros1 else made.deserialize_cdr
    names: dict[str, str] = {}

    def decode(data: bytes, kind: str) -> Any:
        name = names.get(kind) or names.setdefault(kind, full_name(kind))
        try:
            return read(data, name)
        except Exception as error:
            raise ValueError(" ".join(str(error).split())[:200] or "cut short") from error

    return decode
