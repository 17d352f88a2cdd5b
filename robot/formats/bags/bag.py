"""A bag: its topics, and what is kept of their messages, in the order they were written."""

from __future__ import annotations

from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.chunks import MAX_CHUNK, damage_in_one_line, unpack
from moteslam.robot.formats.bags.files import open_files
from moteslam.robot.values import Issue, counted

SECOND = 1_000_000_000
"""Nanoseconds."""

MAX_MESSAGES = 20_000_000
"""No bag has more: an hour of twenty streams at 250 Hz."""


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
    digest: str = ""
    count: int = 0
    channels: frozenset[tuple[int, int]] = frozenset()


@dataclass(eq=False)
class Table:
    """What is kept of the messages of a topic, in the order they were written; a broken one is counted alone.

    Attributes:
        topic: of them.
        take: gives the numbers that are kept of a message, ``width`` of them; raises a ValueError for a broken one.
        stamps: [n] of the headers [ns]; received: [n] when they came [ns]; order: [n] their number in the bag.
        places: [n * 4] where they lie; numbers: [n * width]; marks: [n] checksums; frames: [n] indices of ``names``.
        child: the child frame of an odometry.
        broken: how many were.
    """

    topic: Topic
    take: Callable[[Any], tuple[float, ...]] = lambda _: ()
    width: int = 0
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
        return np.array(self.numbers).reshape(len(self.stamps), self.width)

    def frame(self, index: int = 0) -> str:
        """The frame of a message's header."""
        return list(self.names)[self.frames[index]] if len(self.frames) else ""

    def places_of(self, rows: NDArray[np.intp]) -> NDArray[np.int64]:
        """Where some messages [k] lie [k, 4]."""
        return np.array(self.places, np.int64).reshape(-1, 4)[rows]


class Bag:
    """A bag; messages are read from its files whenever they are asked for."""

    def __init__(self, path: Path) -> None:
        self.path, self.issues = path, list[Issue]()
        self._files = open_files(path, self, self.issues)
        channels = [each for file in self._files for each in file.channels.values()]
        encodings = {each.encoding for each in channels} & {"cdr", "ros1"}
        if len(encodings) > 1:
            raise InputError("messages of ROS 1 and of ROS 2, expected one of them", file=path)
        self.ros1 = encodings == {"ros1"}
        parts: dict[tuple[str, str, str], list[tuple[int, int]]] = {}
        for number, file in enumerate(self._files):
            if file.damage:
                text = f"{file.path.name}: {file.damage}; what can be read is used"
                self.issues.append(Issue("damaged-bag", text))
            for own, channel in file.channels.items():
                if channel.encoding in encodings:
                    name = "/" + "/".join(part for part in channel.topic[:4096].split("/") if part)
                    parts.setdefault((name, channel.kind[:4096], channel.digest), []).append((number, own))
        totals = [file.totals() for file in self._files]
        self.topics = [
            Topic(*key, sum(totals[number].get(own, 0) for number, own in found), frozenset(found))
            for key, found in parts.items()
        ]
        if (total := sum(topic.count for topic in self.topics)) > MAX_MESSAGES:
            raise InputError(f"{total} messages, expected at most {MAX_MESSAGES}", file=path)

    def of_kind(self, *kinds: str) -> list[Topic]:
        """The topics of these types that have messages and are read here, those with most first, then by name."""
        found = [topic for topic in self.topics if topic.kind in kinds and topic.count and is_readable(topic)]
        return sorted(found, key=lambda topic: (-topic.count, topic.name))

    def sweep(self, topics: Collection[Topic]) -> Iterator[tuple[Topic, int, tuple[int, int, int, int], bytes]]:
        """The messages of some topics: when they were received [ns], where they lie, and their bytes."""
        for number, file in enumerate(self._files):
            known = {own: topic for topic in topics for at, own in topic.channels if at == number}
            for channel, received, place, data in file.messages(known.keys()) if known else ():
                yield known[channel], received, (number, *place), self._plain(number, data)

    def payloads(self, places: NDArray[np.int64]) -> Iterator[bytes]:
        """The messages at some places [n, 4]."""
        for number, found in groupby(places.tolist(), key=lambda place: place[0]):
            for data in self._files[number].payloads([(*place,) for _, *place in found]):
                yield self._plain(number, data)

    def _plain(self, number: int, data: bytes) -> bytes:
        if not self._files[number].packed:
            return data
        with damage_in_one_line(self._files[number].path):
            return unpack(data, "zstd", MAX_CHUNK)

    def decode(self, topic: Topic, data: bytes) -> Any:
        """A message; a ValueError where it is not what its type says."""
        return _decoder(ros1=self.ros1)(data, topic.kind)

    def fill(self, tables: Mapping[Topic, Table], others: Mapping[Topic, Callable[[Any, int], None]]) -> int:
        """Go through the bag once: every message of a table's topic is a row, those of the others are handed on.

        Returns:
            how many of the others' are broken.
        """
        broken, order = 0, -1
        decode = _decoder(ros1=self.ros1)
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
        if (lost := sum(topic.count for topic in (*tables, *others)) - order - 1) > 0:
            text = (
                f"{self.path.name}: {counted(lost, 'message')} of its index cannot be found; what can be read is used"
            )
            self.issues.append(Issue("damaged-bag", text, lost))
        return broken


def frame_name(name: str) -> str:
    """A frame's name without the leading slash of ROS before 2012."""
    return name.lstrip("/")


def full_name(kind: str) -> str:
    """The type's name as ROS 2 has it."""
    return kind.replace("/", "/msg/", 1)


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
def is_readable(topic: Topic) -> bool:
    """Whether a topic's messages are of the definition that is read here, as far as the bag says."""
    known, name = store(ros1=True), full_name(topic.kind)
    return topic.digest in ("", "*") or (name in known.types and topic.digest == known.generate_msgdef(name)[1])


@cache
def _decoder(*, ros1: bool) -> Callable[[bytes, str], Any]:
    """What makes a message of bytes and its type, and a ValueError of whatever rosbags stumbles over."""
    read = store(ros1=ros1).deserialize_ros1 if ros1 else store(ros1=ros1).deserialize_cdr

    def decode(data: bytes, kind: str) -> Any:
        try:
            return read(data, full_name(kind))
        except Exception as error:
            raise ValueError(" ".join(str(error).split())[:200] or "cut short") from error

    return decode
