"""A bag: the topics of its file, or of the files of its folder, and their messages in the order they were written."""

from __future__ import annotations

import re
import shutil
import tempfile
from array import array
from collections.abc import Callable, Collection, Iterator, Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags.containers import (
    MAX_CHUNK,
    MAX_MESSAGES,
    MAX_RATIO,
    Container,
    begins_as,
    damage_in_one_line,
    is_bag_database,
    open_container,
    zstd,
)
from moteslam.robot.issues import Issue
from moteslam.robot.yaml_table import read_yaml

METADATA, _TABLE = "metadata.yaml", "rosbag2_bagfile_information"
_MAX_FILES = 10_000
_PART = re.compile(r"(?P<stem>.*)_(?P<number>\d+)\.(?P<ending>mcap|db3|bag)")
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
        with damage_in_one_line(path):
            self._containers = self._folder() if path.is_dir() else (open_container(path),)
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
                parts.setdefault(key, []).append((number, channel.number, channel.count))
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
        for first, last in zip(edges[:-1], edges[1:], strict=True):
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

    def _folder(self) -> tuple[Container, ...]:
        """The files that ``metadata.yaml`` names, or the parts of a recording whose recorder did not write one."""
        if not _has_metadata(self.path):
            parts = parts_of(self.path)
            if not parts:
                raise InputError("neither metadata.yaml nor parts of a recording, expected a ROS 2 bag", file=self.path)
            numbers = [int(_PART.fullmatch(part.name)["number"]) for part in parts]  # type: ignore[index]
            gaps = f"; {len(missing)} between them are missing" if (missing := _missing(numbers)) else ""
            text = f"{self.path.name}: no metadata.yaml; {', '.join(part.name for part in parts[:4])}"
            text += f"{' and others' if len(parts) > 4 else ''} are read as one recording{gaps}"
            self.issues.append(Issue("no-metadata", text, len(parts)))
            return tuple(open_container(part) for part in parts)
        path = self.path / METADATA
        table = read_yaml(path, "the metadata of a ROS 2 bag", limit=4_000_000)
        about = table.get(_TABLE) if isinstance(table, dict) else None
        if not isinstance(about, dict):
            raise InputError("missing or no table", file=path, field=_TABLE)
        mode, packing = str(about.get("compression_mode") or "none").lower(), about.get("compression_format")
        if mode not in ("none", "storage") and (mode not in ("message", "file") or packing != "zstd"):
            raise InputError(f"{mode[:20]} {str(packing)[:20]}, expected zstd", file=path, field="compression_mode")
        names = about.get("relative_file_paths")
        if (
            not isinstance(names, list)
            or not names
            or len(names) > _MAX_FILES
            or len(set(map(str, names))) < len(names)
        ):
            raise InputError("no list of files, expected one", file=path, field="relative_file_paths")
        files = [self._inside(str(name)) for name in names]
        if mode == "file":
            self._unpacked = tempfile.TemporaryDirectory(prefix="moteslam-")
            files = [_unpack(file, Path(self._unpacked.name, f"{index}")) for index, file in enumerate(files)]
        opened = [open_container(file) for file in files]
        return tuple(_PackedMessages(container) if mode == "message" else container for container in opened)

    def _inside(self, name: str) -> Path:
        """The file of that name in the folder; bags before version 4 name it with the folder before it."""
        file, inside = self.path / Path(name).name, not {"..", ""} & set(name.split("/"))
        if (
            "\0" in name
            or "\\" in name
            or not inside
            or not file.is_file()
            or file.resolve().parent != self.path.resolve()
        ):
            problem = f"{name[:80]!r}, expected the name of a file in the folder"
            raise InputError(problem, file=self.path / METADATA, field="relative_file_paths")
        return file


class _PackedMessages:
    """A file whose messages are packed by Zstandard one by one; see `Container`."""

    def __init__(self, container: Container) -> None:
        self.path, self.ros1, self.damage = container.path, container.ros1, container.damage
        self.channels, self._container = container.channels, container

    def messages(self, channels: Collection[int]) -> Iterator[Any]:
        for message in self._container.messages(channels):
            yield message._replace(data=self._unpack(message.data))

    def payloads(self, places: Collection[tuple[int, int]]) -> Iterator[bytes]:
        yield from map(self._unpack, self._container.payloads(places))

    def _unpack(self, data: bytes) -> bytes:
        with damage_in_one_line(self.path):
            return bytes(zstd().ZstdDecompressor().decompress(data, max_length=MAX_CHUNK))


def _unpack(file: Path, into: Path) -> Path:
    """A file packed as a whole, unpacked."""
    limit = MAX_RATIO * file.stat().st_size
    with zstd().open(file, "rb") as packed, into.open("wb") as plain:
        while block := packed.read(1 << 20):
            plain.write(block)
            if plain.tell() > min(limit, shutil.disk_usage(into.parent).total // 2):
                raise InputError("unpacks to more than a recording does: unpack it with zstd -d", file=file)
    return into


def _has_metadata(folder: Path) -> bool:
    try:
        with (folder / METADATA).open("rb") as file:
            return _TABLE.encode() in file.read(4096)
    except OSError:
        return False


def is_bag_folder(folder: Path) -> bool:
    """Whether a folder holds the ``metadata.yaml`` of a bag, or the parts of a single one."""
    return _has_metadata(folder) or bool(parts_of(folder))


def parts_of(folder: Path) -> list[Path]:
    """The parts ``name_0.mcap``, ``name_1.mcap`` of the one recording in a folder, in order; else none."""
    try:
        files = [file for _, file in zip(range(_MAX_FILES), folder.iterdir(), strict=False) if begins_as(file)]
    except OSError:
        return []
    parts = [(found, file) for file in files if (found := _PART.fullmatch(file.name))]
    one = len({(found["stem"], found["ending"]) for found, _ in parts}) == 1 and len(parts) == len(files)
    if not one or any(file.suffix == ".db3" and not is_bag_database(file) for file in files):
        return []
    return [file for _, file in sorted(parts, key=lambda part: int(part[0]["number"]))]


def _missing(numbers: list[int]) -> set[int]:
    return set(range(numbers[0], min(numbers[-1], numbers[0] + _MAX_FILES))) - set(numbers)


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
