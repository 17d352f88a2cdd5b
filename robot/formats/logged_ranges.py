"""The ranges of a log that is still being written: kept as logged, tallied as they come, cleaned when asked for.

What a range means follows from the lidar's limit, and that may follow from ranges to come; so they stay raw.
"""

from __future__ import annotations

from array import array
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.formats.no_return import RangeTally
from moteslam.robot.formats.ranges import clean_ranges, invalid_issue, invalid_ranges
from moteslam.robot.issues import Issue
from moteslam.robot.ranges import ChunkedRanges


class LoggedRanges:
    """Ranges of scans, to which more are appended.

    Args:
        values: flat [n * beams] float32 [m], as logged; whoever parses the log appends to it.
        beams: of a scan.
    """

    def __init__(self, values: array[float], beams: int) -> None:
        self.values = values
        self._beams = beams
        self._tally, self._tallied, self._invalid = RangeTally(), 0, (0, 0)

    @property
    def shape(self) -> tuple[int, int]:
        """(n, beams)."""
        return len(self.values) // self._beams, self._beams

    def raw(self, first: int, last: int) -> NDArray[np.float32]:
        """The ranges [last - first, beams] of scans as logged [m]."""
        return np.array(self.values[first * self._beams : last * self._beams], np.float32).reshape(-1, self._beams)

    def limit(self, stated: float | None) -> float:
        """From which range on a reading is no endpoint [m]: as `no_return_limit` of all ranges until now."""
        self._count()
        return self._tally.limit(stated)

    def cleaned(
        self,
        order: NDArray[np.intp],
        range_min: float,
        range_max: float,
        *,
        file: Path,
        field: str,
        zero_is_invalid: bool = True,
    ) -> tuple[ChunkedRanges, tuple[Issue, ...]]:
        """The scans of now in an order [n], as `clean_ranges` gives them, and its issue.

        A range of 0 is invalid, too, unless ``zero_is_invalid`` is False.
        """
        self._count()

        def load(first: int, last: int) -> NDArray[np.float32]:
            scans = order[first:last]
            start, end = int(scans.min()), int(scans.max()) + 1
            raw = self.raw(start, end)[scans - start] if end - start <= 2 * len(scans) else self._scattered(scans)
            clean, _ = clean_ranges(raw, range_min, range_max, file=file, field=field)
            if zero_is_invalid:
                clean[clean == 0] = np.nan
            return clean

        return ChunkedRanges(load, len(order), self._beams), invalid_issue(*self._invalid, file=file, field=field)

    def _scattered(self, scans: NDArray[np.intp]) -> NDArray[np.float32]:
        return np.concatenate([self.raw(scan, scan + 1) for scan in scans.tolist()])

    def _count(self) -> None:
        """Count what was appended since."""
        raw = self.raw(self._tallied, self.shape[0])
        self._tally.add(raw)
        count, scans = invalid_ranges(raw)
        self._invalid = (self._invalid[0] + count, self._invalid[1] + scans)
        self._tallied = self.shape[0]
