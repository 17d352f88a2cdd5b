"""A bag: its topics, over all of its files, and their messages in the order of time or of the file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.bags import database, mcap, mcap_index, rosbag1
from moteslam.robot.formats.bags.container import MAX_MESSAGE, MAX_MESSAGES, Container, Indices
from moteslam.robot.formats.bags.rosbag2 import open_rosbag2
from moteslam.robot.issues import Issue
from moteslam.robot.reading import open_regular

BLOCK = 16_384
"""Messages whose places are Python's numbers at a time, of 150 bytes each: all those of an hour would be 120 MB."""


@dataclass(frozen=True, eq=False)
class Topic:
    """The messages of one topic and type.

    Attributes:
        name: with a leading slash.
        kind: the type, ``sensor_msgs/LaserScan``.
        digest: of the type's definition, where the bag states one.
        received: [n] when each was received [ns], rising.
        where: [n, 3] where each lies: the number of the file, and a place in it.
    """

    name: str
    kind: str
    digest: str
    received: Indices
    where: Indices

    def __len__(self) -> int:
        return len(self.received)


class Bag:
    """A bag by its index; messages are read from its files whenever they are asked for.

    Args:
        path: of the file or folder.
        containers: its files, where they are known; they are opened if None.

    Raises:
        InputError: no bag, or one that is damaged.
    """

    def __init__(self, path: Path, containers: tuple[Container, ...] | None = None) -> None:
        self.path = path
        self._containers = _containers(path) if containers is None else containers
        if len({container.ros1 for container in self._containers}) > 1:
            raise InputError("files of ROS 1 and of ROS 2, expected one of them", file=path)
        self.ros1 = self._containers[0].ros1
        self.topics = _topics(path, self._containers)
        self.issues = tuple(
            Issue("damaged-bag", f"{container.path.name}: {container.damage}; what came before is used")
            for container in self._containers
            if container.damage
        )

    def of_kind(self, *kinds: str) -> list[Topic]:
        """The topics of these types that have messages, those with most first, then by name."""
        found = [topic for topic in self.topics if topic.kind in kinds and len(topic)]
        return sorted(found, key=lambda topic: (-len(topic), topic.name))

    def messages(
        self, topic: Topic, indices: NDArray[np.integer] | None = None, *, at_most: int = MAX_MESSAGE
    ) -> Iterator[bytes]:
        """Messages of a topic in the order of the indices [m], all if None; of each up to ``at_most`` bytes.

        Raises:
            InputError: the file is damaged where they lie.
        """
        where = topic.where if indices is None else topic.where[indices]
        for _, data in self._read(where, np.full(len(where), at_most)):
            yield data

    def sweep(self, wanted: Mapping[str, tuple[Topic, int]]) -> Iterator[tuple[str, int, bytes]]:
        """The messages of several topics in the order of the file, so that each part of it is read once.

        Args:
            wanted: by a key, a topic and how many bytes of each message.

        Yields:
            the key, which message of the topic, and its bytes.
        """
        keys = list(wanted)
        topics = [wanted[key][0] for key in keys]
        if not keys:
            return
        where = np.concatenate([topic.where for topic in topics])
        owner = np.repeat(np.arange(len(keys), dtype=np.int32), [len(topic) for topic in topics])
        index = np.concatenate([np.arange(len(topic), dtype=np.int32) for topic in topics])
        sizes = np.array([wanted[key][1] for key in keys])
        order = np.lexsort(where.T[::-1])
        for first in range(0, len(order), BLOCK):
            block = order[first : first + BLOCK]
            owners, indices = owner[block].tolist(), index[block].tolist()
            for at, data in self._read(where[block], sizes[owner[block]]):
                yield keys[owners[at]], indices[at], data

    def forget_index(self) -> None:
        """Free the index; messages of a topic that is held elsewhere can still be read."""
        self.topics = ()
        for container in self._containers:
            container.channels = ()

    def _read(self, where: Indices, at_most: Indices) -> Iterator[tuple[int, bytes]]:
        """Messages with their number, file by file where that changes."""
        edges = np.flatnonzero(np.diff(where[:, 0])) + 1
        for first, last in zip([0, *edges.tolist()], [*edges.tolist(), len(where)], strict=True):
            if first < last:
                container = self._containers[int(where[first, 0])]
                payloads = container.payloads(where[first:last, 1:], at_most[first:last])
                yield from enumerate(payloads, start=first)


def begins_as(path: Path) -> str | None:
    """The kind of bag that a file begins as, ``bag``, ``mcap`` or ``db3``, else None; no more than it is promised."""
    kinds = {rosbag1.MAGIC: "bag", mcap_index.MAGIC: "mcap", database.MAGIC: "db3"}
    try:
        with path.open("rb") as file:
            start = file.read(16)
    except OSError:
        return None
    return next((kind for magic, kind in kinds.items() if start.startswith(magic)), None)


def _containers(path: Path) -> tuple[Container, ...]:
    if path.is_dir():
        return open_rosbag2(path)
    open_regular(path, "a ROS bag").close()
    match begins_as(path):
        case "bag":
            return (rosbag1.Rosbag1(path),)
        case "mcap":
            return (mcap.Mcap(path),)
        case "db3":
            return (database.Database(path),)
    raise InputError("does not begin as a ROS bag, an MCAP or a SQLite file", file=path)


def _topics(path: Path, containers: tuple[Container, ...]) -> tuple[Topic, ...]:
    """The channels of one topic, type and definition, together, in the order of reception."""
    parts: dict[tuple[str, str, str], list[tuple[Indices, Indices]]] = {}
    total = 0
    for number, container in enumerate(containers):
        for channel in container.channels:
            total += len(channel.received)
            where = np.column_stack((np.full(len(channel.received), number), channel.places))
            parts.setdefault((channel.topic, channel.kind, channel.digest), []).append((channel.received, where))
    if total > MAX_MESSAGES:
        raise InputError(f"{total} messages, expected at most {MAX_MESSAGES}", file=path)
    topics = []
    for (name, kind, digest), found in parts.items():
        received = np.concatenate([part[0] for part in found])
        where = np.concatenate([part[1] for part in found])
        order = np.argsort(received, kind="stable")
        topics.append(Topic(name, kind, digest, received[order], where[order]))
    return tuple(topics)
