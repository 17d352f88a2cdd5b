"""Beams as wide as they are: mixed ranges at edges, and early echoes of rain and dust."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

EDGE = 0.1
"""Smallest distance between the two sides of an edge, beyond the slope of the surface [m]."""


def mix_at_edges(
    ranges: NDArray[np.float32],
    middle: NDArray[np.float32],
    sides: NDArray[np.float32],
    *,
    mixed: float,
    pulse: float,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """The ranges of beams, some of whose sides meet something else than their middle.

    On one flat surface the sides lie about as far before the middle as behind it; at an edge one of them does not.
    There, with probability ``mixed``, the two echoes melt into one in between, if they are at most ``pulse`` apart;
    otherwise the range is that of one of them.

    Args:
        ranges: [n] the ranges of the beams as lines [m].
        middle: [n] where their middles end; sides: [2, n] where their sides end [m].
        mixed: probability that two echoes melt into one.
        pulse: largest distance between two echoes that melt into one [m].
        rng: drawn from, two numbers a beam.
    """
    with np.errstate(invalid="ignore"):
        step = np.abs(sides - middle)
        bend = np.abs(sides[0] + sides[1] - 2 * middle)
        edge = np.isfinite(ranges) & np.isfinite(middle) & ~(bend <= EDGE) & (step.max(0) > EDGE)
    which = (step[1] > step[0]).astype(np.int64)
    which = np.where(np.isfinite(step).all(0), which, np.where(np.isfinite(step[0]), 1, 0))
    other = np.take_along_axis(sides, which[None], axis=0)[0]
    share, draw = rng.random((2, len(ranges)), np.float32)
    with np.errstate(invalid="ignore"):
        apart = np.abs(other - middle)
        melted = middle + share * (other - middle)
        melts = (draw < mixed) & (apart <= pulse)
    # a quarter of the beam's width lies on the other side of the edge, on average
    alone = np.where((share < 0.25) & np.isfinite(other), other, ranges)
    return np.where(edge, np.where(melts, melted, alone), ranges).astype(np.float32)


def add_false_returns(
    ranges: NDArray[np.float32], *, share: float, nearest: float, scale: float, rng: np.random.Generator
) -> NDArray[np.float32]:
    """Ranges [n], some of them cut short by what floats in the air (z_short of Probabilistic Robotics, table 6.1).

    Args:
        ranges: [n] without it [m].
        share: of the beams that meet a drop or grain.
        nearest: range of the nearest [m].
        scale: mean distance beyond that [m] (exponential).
        rng: drawn from, two numbers a beam.
    """
    met = rng.random(len(ranges), np.float32) < share
    drop = nearest + rng.exponential(scale, len(ranges))
    return np.where(met & ~(drop >= ranges), drop, ranges).astype(np.float32)
