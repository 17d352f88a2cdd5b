"""What most messages of a topic begin with, decoded for many at a time: their header, and the numbers behind it.

Both serialisations put the stamp of a header at bytes 4 to 12 and its frame behind it; where that text ends, and so
where the numbers begin, is the same in nearly all messages of a topic.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.formats.bags.cursor import BrokenMessageError, Cursor, byte_order

BATCH = 2048
"""Messages that are decoded at a time."""

HEAD = 1024
"""Bytes of a message that are read for its header and the numbers behind it."""


@dataclass(frozen=True, eq=False)
class Heads:
    """The beginnings of messages.

    Attributes:
        stamps: [n] of the headers [ns]; 0 of a broken message.
        texts: [n] the texts behind each stamp: the header's frame, and the child frame of an odometry.
        values: [n, k] the numbers behind these.
        broken: [n] whether a message is not what its type says.
    """

    stamps: NDArray[np.int64]
    texts: list[tuple[bytes, ...]]
    values: NDArray[Any]
    broken: NDArray[np.bool_]


class HeadReader:
    """Collects the heads of messages as they come, in any order, and decodes them in batches.

    Args:
        count: of messages.
        ros1: whether they are serialised as in ROS 1.
        texts: how many texts stand behind the stamp.
        kind: of the numbers behind these, as NumPy names it, ``f8``.
        width: how many.
        columns: which of these are kept; all if None.
    """

    def __init__(
        self, count: int, *, ros1: bool, texts: int, kind: str, width: int, columns: Sequence[int] | None = None
    ) -> None:
        self._ros1, self._texts, self._kind, self._width = ros1, texts, kind, width
        self._columns = np.arange(width) if columns is None else np.array(columns)
        self._waiting: list[tuple[int, bytes]] = []
        self._count = 0
        self._heads = Heads(np.zeros(0, np.int64), [], np.zeros((0, len(self._columns)), kind), np.ones(0, np.bool_))
        self.grow(count)

    def grow(self, count: int) -> None:
        """Make room for a number of messages in all."""
        heads, self._count = self._heads, count
        heads.texts.extend([()] * (count - len(heads.texts)))
        if count > len(heads.stamps):
            room = max(count, 2 * len(heads.stamps))
            self._heads = Heads(
                enlarged(heads.stamps, room, 0),
                heads.texts,
                enlarged(heads.values, room, 0),
                enlarged(heads.broken, room, 1),
            )

    def add(self, index: int, data: bytes) -> None:
        """A message, or its first `HEAD` bytes."""
        self._waiting.append((index, data))
        if len(self._waiting) >= BATCH:
            self._decode()

    def heads(self) -> Heads:
        """All of them."""
        self._decode()
        heads, n = self._heads, self._count
        return Heads(heads.stamps[:n], heads.texts, heads.values[:n], heads.broken[:n])

    def _decode(self) -> None:
        groups: dict[bytes, list[tuple[int, bytes]]] = {}
        order, start = 0 if self._ros1 else 2, 12
        for index, data in self._waiting:
            key = data[:order] + data[12:start]
            if key not in groups:  # the first, or one with other texts
                try:
                    start = self._start(data)
                except BrokenMessageError:
                    continue
                key = data[:order] + data[12:start]
            groups.setdefault(key, []).append((index, data))
        self._waiting.clear()
        for group in groups.values():
            self._decode_alike([index for index, _ in group], [data for _, data in group])

    def _start(self, data: bytes) -> int:
        """Where the numbers begin."""
        cursor = Cursor(data, ros1=self._ros1)
        cursor.position = 12
        for _ in range(self._texts):
            cursor.raw_text()
        cursor.align(np.dtype(self._kind).itemsize)
        return cursor.position

    def _decode_alike(self, indices: list[int], found: Sequence[bytes]) -> None:
        """Messages with the same texts."""
        order = "<" if self._ros1 else byte_order(found[0])
        start = self._start(found[0])
        end = start + self._width * np.dtype(self._kind).itemsize
        whole = [len(data) >= end for data in found]
        at = np.array(indices)[whole]
        rows = np.frombuffer(b"".join(data[:end] for data, good in zip(found, whole, strict=True) if good), np.uint8)
        rows = rows.reshape(len(at), end)
        time = np.ascontiguousarray(rows[:, 4:12]).view(f"{order}u4").astype(np.int64)
        heads = self._heads
        heads.stamps[at] = time[:, 0] * 1_000_000_000 + time[:, 1]
        heads.values[at] = np.ascontiguousarray(rows[:, start:end]).view(f"{order}{self._kind}")[:, self._columns]
        heads.broken[at] = False
        cursor = Cursor(found[0], ros1=self._ros1)
        cursor.position = 12
        texts = tuple(cursor.raw_text() for _ in range(self._texts))
        for index in at.tolist():
            heads.texts[index] = texts


def enlarged(values: NDArray[Any], room: int, filling: float) -> NDArray[Any]:
    """An array of ``room`` rows: those of the values [n, ...], then rows filled with a number."""
    more = np.full((room - len(values), *values.shape[1:]), filling, values.dtype)
    return np.concatenate((values, more))
