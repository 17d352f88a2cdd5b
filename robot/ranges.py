"""The ranges of a lidar's scans: an array, or the same read from its file a chunk at a time."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

CHUNK = 256
"""Scans that are read at a time: 1.1 MB of a lidar of 1081 beams."""

_KEPT = 4
"""Chunks that are kept: neighbouring scans, and two places of a recording that are compared."""


class Ranges(Protocol):
    """Ranges [n, beams] float32 [m], indexed as an array is: by scan, slice, mask or indices, then by beam."""

    @property
    def shape(self) -> tuple[int, ...]:
        """(n, beams)."""

    @property
    def dtype(self) -> np.dtype[Any]:
        """float32."""

    @property
    def size(self) -> int:
        """How many ranges there are."""

    def __len__(self) -> int:
        """How many scans there are."""

    def __getitem__(self, key: Any, /) -> Any:
        """The ranges of a scan or of several, as an array."""


class ChunkedRanges:
    """Ranges that are read when they are asked for, and forgotten again.

    Args:
        load: ``load(first, last)`` reads the ranges [last - first, beams] of scans as float32 [m]; the same whenever
            it is called.
        scans: n.
        beams: of a scan.
        chunk: scans that are read at a time.
    """

    def __init__(
        self, load: Callable[[int, int], NDArray[np.float32]], scans: int, beams: int, *, chunk: int = CHUNK
    ) -> None:
        self._load, self._chunk = load, chunk
        self._kept: dict[int, NDArray[np.float32]] = {}
        self.shape = (scans, beams)
        self.dtype = np.dtype(np.float32)
        self.size = scans * beams

    def __len__(self) -> int:
        return self.shape[0]

    def __getitem__(self, key: Any, /) -> Any:
        if isinstance(key, tuple):
            scans, beams = key
            return self[scans][..., beams]
        if isinstance(key, int | np.integer):
            index = range(len(self))[int(key)]
            return self._at(index // self._chunk)[index % self._chunk]
        indices = np.arange(len(self))[key]
        found = np.empty((len(indices), self.shape[1]), np.float32)
        for number in np.unique(indices // self._chunk).tolist():
            here = indices // self._chunk == number
            found[here] = self._at(number)[indices[here] % self._chunk]
        return found

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray[Any]:
        return np.asarray(self[:], dtype)

    def chosen(self, indices: NDArray[np.intp]) -> ChunkedRanges:
        """The ranges of some scans [m], in this order; read when they are asked for."""
        return ChunkedRanges(
            lambda first, last: self[indices[first:last]], len(indices), self.shape[1], chunk=self._chunk
        )

    def _at(self, number: int) -> NDArray[np.float32]:
        """A chunk, by its number."""
        if number not in self._kept:
            while len(self._kept) >= _KEPT:
                del self._kept[next(iter(self._kept))]
            first = number * self._chunk
            chunk = self._load(first, min(first + self._chunk, len(self)))
            chunk.setflags(write=False)
            self._kept[number] = chunk
        return self._kept[number]


def chosen(ranges: Ranges, indices: NDArray[np.intp]) -> Ranges:
    """The ranges of some scans [m] in this order; those of a file stay there until they are asked for."""
    return ranges.chosen(indices) if isinstance(ranges, ChunkedRanges) else ranges[indices]


def chunks(ranges: Ranges) -> Iterator[NDArray[np.float32]]:
    """All ranges in order, `CHUNK` scans at a time."""
    for first in range(0, len(ranges), CHUNK):
        yield ranges[first : first + CHUNK]
