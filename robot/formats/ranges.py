"""What a raw range means: an endpoint, no return (``inf``), or invalid (``nan``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.issues import Issue
from moteslam.robot.wording import counted


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
    garbage = ~(ranges >= 0)
    clean = ranges.copy()
    clean[ranges >= np.float32(range_max)] = np.inf
    clean[garbage | (ranges < np.float32(range_min))] = np.nan
    count = int(garbage.sum())
    if not count:
        return clean, ()
    scans = int(garbage.any(axis=1).sum())
    found = f"{counted(count, 'range')} in {counted(scans, 'scan')}"
    return clean, (Issue("invalid-ranges", f"{file.name}: {field}: {found} left out, NaN or negative", count),)
