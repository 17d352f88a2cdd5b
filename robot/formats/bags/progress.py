"""How far the messages of a bag were gone through: of a bag that grows, only those that follow are read."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Protocol, TypeVar, cast

import numpy as np

from moteslam.robot.formats.bags.bag import Bag, Topic
from moteslam.robot.formats.bags.container import Indices
from moteslam.robot.formats.bags.transforms import TransformReader

MAX_TRANSFORMS = 4 << 20
"""Bytes of a message of transforms."""


class MessageReader(Protocol):
    """Takes messages of a topic by their number, in any order."""

    def add(self, index: int, data: bytes, /) -> None:
        """A message, or the first bytes of it."""


class GrowingReader(MessageReader, Protocol):
    """One that has a place for each message."""

    def grow(self, count: int) -> None:
        """Make room for a number of messages in all."""


R = TypeVar("R", bound=GrowingReader)


class Progress:
    """The readers of a bag's topics, and which messages they have read.

    A topic whose earlier messages are no longer the same, as where one comes that was received before them, is gone
    through anew.
    """

    def __init__(self) -> None:
        self._readers: dict[str, MessageReader] = {}
        self._read: dict[str, Indices] = {}
        self._wanted: dict[str, tuple[Topic, int]] = {}

    def reader(self, key: str, topic: Topic, at_most: int, make: Callable[[], R]) -> R:
        """The reader of a topic, which `go_on` gives the next messages.

        Args:
            key: what it reads; a topic may have several.
            topic: as it is now.
            at_most: bytes of a message that it reads.
            make: makes it, for all messages of the topic.
        """
        key = f"{key} {topic.name}"
        if not self._has(key, topic):
            self._readers[key], self._read[key] = make(), topic.where[:0]
        reader = cast(R, self._readers[key])
        reader.grow(len(topic))
        self._wanted[key] = (topic, at_most)
        return reader

    def transforms(self, topics: Sequence[Topic], *, ros1: bool) -> TransformReader:
        """The one reader of all transforms, which `go_on` gives the next ones."""
        keys = [f"transforms {topic.name} {topic.kind} {topic.digest}" for topic in topics]
        known = [key for key in self._read if key.startswith("transforms ")]
        reader = next((cast(TransformReader, self._readers[key]) for key in known), None)
        there = dict(zip(keys, topics, strict=True))
        if reader is None or not all(key in there and self._has(key, there[key]) for key in known):
            reader = TransformReader(ros1=ros1)
            for key in known:
                del self._readers[key], self._read[key]
        for key, topic in there.items():
            self._readers[key], self._wanted[key] = reader, (topic, MAX_TRANSFORMS)
            self._read.setdefault(key, topic.where[:0])
        return reader

    def go_on(self, bag: Bag) -> None:
        """Give the readers asked for since the last call the messages that they have not read, in the file's order."""
        rest = {}
        for key, (topic, at_most) in self._wanted.items():
            first = len(self._read[key])
            rest[key] = replace(topic, received=topic.received[first:], where=topic.where[first:]), at_most
        for key, index, data in bag.sweep(rest):
            self._readers[key].add(len(self._read[key]) + index, data)
        for key, (topic, _) in self._wanted.items():
            self._read[key] = topic.where
        self._wanted.clear()

    def _has(self, key: str, topic: Topic) -> bool:
        """Whether the messages that were read under a key are still the first of a topic."""
        read = self._read.get(key)
        return read is not None and np.array_equal(topic.where[: len(read)], read)
