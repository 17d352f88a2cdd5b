"""What stands for 'no return': which ranges of a laser that says nothing about its limit, and what is written."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

SICK_REACH = 80.0
"""A SICK LMS reaches 80 m and reports 'no return' and its errors as 81.83, 81.91 and the like [m]."""

SICK_CODES = 82.0
"""Its codes end below this [m]."""

_SHARE = 0.002
_TIMES = 5
_FEWEST = 10
_BINS = 10_000
"""Values of a range in a metre: a tenth of a millimetre each."""
_CODES = 0.0015
"""Within this share of the longest range lie the codes that a lidar has beside it: a SICK's end at 8.183, 8.187, 8.191
or ten times that [m]."""


def no_return_limit(ranges: NDArray[np.float32], stated: float | None) -> float:
    """The range from which on a reading is no endpoint [m]. No table of data sets, only what the log itself says.

    1. What the log states, unless that lies among the codes of a SICK (80 to 82 m), of which it has several: 80 m.
    2. Else 80 m, if any range is that long.
    3. Else the most frequent of the longest ranges, those within 0.15 % of the longest (lidars have several codes), if
       it is a spike: at least 0.2 % of all beams and 10 of them stand at this value, to a tenth of a millimetre, 5
       times as many as at any other in the upper half of the ranges, and ranges below it exist. (In the logs we know,
       0.5 to 12 % of the beams stand at the limit, and no other long range reaches 0.02 %.)
    4. Else 80 m: every range is an endpoint.

    Args:
        ranges: of the whole log, any shape [m]; not finite ones are left aside.
        stated: the limit that the log states [m], or None.
    """
    if stated is not None:
        return SICK_REACH if SICK_REACH < stated <= SICK_CODES else stated
    finite = ranges[np.isfinite(ranges)]
    finite = finite[finite >= 0]
    bins = np.rint(finite.astype(np.float64) * _BINS).astype(np.int64)
    if not len(bins) or bins.max() >= SICK_REACH * _BINS:
        return SICK_REACH
    tally = np.bincount(bins)
    used = np.flatnonzero(tally)
    values, counts = used / _BINS, tally[used]
    code = int(np.where(values > values[-1] * (1 - _CODES), counts, 0).argmax())
    upper = values >= values[-1] / 2
    upper[code] = False
    spike = counts[code] >= max(_SHARE * len(bins), _FEWEST, _TIMES * counts[upper].max(initial=0))
    if spike and (values[:code] > 0).any():
        return float(finite[bins == used[code]].min())
    return SICK_REACH


def no_return_codes(codes: tuple[float, ...], range_max: float, otherwise: float, beams: int) -> NDArray[np.float32]:
    """What is written for no return, a value a beam [beams] [m]: the lidar's codes in turns.

    Args:
        codes: of the lidar; those below ``range_max`` would read as endpoints and are left aside.
        range_max: from which on a range is no return [m].
        otherwise: written where there is no such code [m].
        beams: how many.
    """
    usable = [code for code in codes if code >= range_max] or [otherwise]
    return np.resize(np.asarray(usable, np.float32), beams)
