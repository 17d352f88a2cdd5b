"""The fields of a serialised message, one after the other: as ROS 1 writes them, or as CDR in either byte order.

ROS 1 packs fields without gaps, little endian (wiki.ros.org/msg). CDR (OMG Common Data Representation, as DDS and
ROS 2 use it) begins with four bytes that state the byte order, aligns every number to its own size, counted from
behind these, and ends texts with a zero.
"""

from __future__ import annotations

import struct
from typing import Any

import numpy as np
from numpy.typing import NDArray


class BrokenMessageError(ValueError):
    """A message that is not what its type says."""


class Cursor:
    """Reads a message from its beginning.

    Args:
        data: the message.
        ros1: whether it is serialised as in ROS 1, else as CDR.

    Raises:
        BrokenMessageError: no CDR message, here; a field that reaches beyond the end, in every method.
    """

    __slots__ = ("_aligned", "_data", "order", "position")

    def __init__(self, data: bytes, *, ros1: bool) -> None:
        self._data, self._aligned, self.order, self.position = data, not ros1, "<", 0
        if not ros1:
            self.order = byte_order(data)
            self.position = 4

    def numbers(self, kinds: str) -> tuple[Any, ...]:
        """Numbers of one size, by their characters in ``struct``: ``ff``, ``ddd``."""
        self.align(struct.calcsize(f"={kinds[0]}"))
        layout = f"{self.order}{kinds}"
        try:
            values = struct.unpack_from(layout, self._data, self.position)
        except struct.error as error:
            raise BrokenMessageError("cut short") from error
        self.position += struct.calcsize(layout)
        return values

    def number(self, kind: str) -> Any:
        """One number."""
        return self.numbers(kind)[0]

    def raw_text(self) -> bytes:
        """A text as its bytes, without the zero that CDR ends it with."""
        size = self.number("I")
        text = self._take(size)
        return text.removesuffix(b"\0") if self._aligned else text

    def text(self) -> str:
        """A text; bytes that are no UTF-8 are replaced."""
        return self.raw_text().decode(errors="replace")

    def array(self, kind: str, count: int | None = None) -> NDArray[Any]:
        """Numbers as an array: ``count`` of them, or as many as the length before them says."""
        size = self.number("I") if count is None else count
        dtype = np.dtype(f"{self.order}{kind}")
        if size:
            self.align(dtype.itemsize)
        return np.frombuffer(self._take(size * dtype.itemsize), dtype)

    def align(self, size: int) -> None:
        """Go on to where a number of that size may begin."""
        if self._aligned:
            self.position += -(self.position - 4) % size

    def _take(self, size: int) -> bytes:
        taken = self._data[self.position : self.position + size]
        if len(taken) < size:
            raise BrokenMessageError("cut short")
        self.position += size
        return taken


def byte_order(data: bytes) -> str:
    """The byte order of a CDR message, as ``struct`` writes it.

    Raises:
        BrokenMessageError: it does not begin as plain CDR of version 1 does.
    """
    if len(data) < 4 or data[0] != 0 or data[1] > 1:
        raise BrokenMessageError("does not begin as a CDR message")
    return "<" if data[1] else ">"
