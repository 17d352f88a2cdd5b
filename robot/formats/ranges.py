"""What a raw range means: an endpoint, no return (``inf``), or nothing (``nan``)."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.wording import counted


def clean_ranges(
    ranges: NDArray[np.float32], range_min: float, range_max: float, *, file: Path, field: str
) -> tuple[NDArray[np.float32], tuple[str, ...]]:
    """Tell endpoints from the rest.

    At or beyond ``range_max``, and ``+inf``: no return, ``inf``. Below ``range_min`` (lidars put error codes there):
    nothing, ``nan``. Negative, ``-inf`` and NaN: nothing, and counted in a warning, for no sensor says that.

    Args:
        ranges: [n, beams] [m], left as it is.
        range_min, range_max: the limits [m].
        file, field: for the warning.

    Returns:
        ranges [n, beams]; and a warning, or none.
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
    return clean, (f"{file.name}: {field}: {found} left out, NaN or negative",)
