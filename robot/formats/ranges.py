"""What a raw range means: an endpoint, no return (``inf``), or invalid (``nan``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.values import Issue, counted


def clean_ranges(
    ranges: NDArray[np.float32], range_min: float, range_max: float, *, file: Path, field: str
) -> tuple[NDArray[np.float32], tuple[Issue, ...]]:
    """Sort ranges into endpoints, no return and invalid.

    At or beyond ``range_max``, and ``+inf``: no return, ``inf``. Below ``range_min`` (lidars put error codes there):
    invalid, ``nan``. Negative, ``-inf`` and NaN: invalid, and counted in an issue, for no sensor reports them.

    Args:
        ranges: [n, beams] [m], left as it is.
        range_min, range_max: the limits [m].
        file, field: for the message.

    Returns:
        ranges [n, beams]; and an issue, or none.
    """
    clean = ranges.copy()
    clean[ranges >= np.float32(range_max)] = np.inf
    clean[~(ranges >= 0) | (ranges < np.float32(range_min))] = np.nan
    return clean, invalid_issue(*invalid_ranges(ranges), file=file, field=field)


def invalid_ranges(ranges: NDArray[np.float32]) -> tuple[int, int]:
    """How many of the ranges [n, beams] no sensor reports, NaN or negative, and in how many scans."""
    garbage = ~(ranges >= 0)
    return int(garbage.sum()), int(garbage.any(axis=1).sum())


def invalid_issue(count: int, scans: int, *, file: Path, field: str) -> tuple[Issue, ...]:
    """The issue of a number of invalid ranges in a number of scans; none where there are none."""
    if not count:
        return ()
    found = f"{counted(count, 'range')} in {counted(scans, 'scan')}"
    return (Issue("invalid-ranges", f"{file.name}: {field}: {found} left out, NaN or negative", count),)
