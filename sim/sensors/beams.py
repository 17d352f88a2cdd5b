"""Beams as wide as they are: what they tell at edges, and what rain and dust do to them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.sim.noise import LidarNoise
from moteslam.sim.sensors.echoes import Floats, Scene

EDGE = 0.1
"""Beyond the slope of the surface, so far apart are the two sides of an edge at least [m]."""


def beam_ranges(
    scene: Scene,
    origins: Floats,
    angles: Floats,
    times: Floats,
    noise: LidarNoise,
    rng: np.random.Generator,
    *,
    max_range: float,
) -> NDArray[np.float32]:
    """The ranges of beams before the sensor's own noise.

    A beam of some divergence is three rays: its middle and its two sides. Where a side meets something else than the
    middle does, the beam falls on an edge: with probability ``noise.mixed`` the two echoes melt into one somewhere in
    between, if they are no more than ``noise.pulse`` apart; otherwise one of them is told.

    Args:
        scene: what the beams meet.
        origins: [n, 2] [m]; angles: [n] [rad]; times: [n] [s], of the beams.
        noise: of the lidar.
        rng: drawn from, only where something is random.
        max_range: [m].

    Returns:
        float32 [n] [m]: ``inf`` for no echo, ``nan`` for one that is of no use.
    """
    ranges = scene.echoes(origins, angles, times, rng, max_range=max_range)
    if noise.divergence > 0:
        half = noise.divergence / 2
        sides = [scene.exact(origins, angles + off, times, max_range=max_range) for off in (-half, half)]
        middle = ranges if scene.is_plain else scene.exact(origins, angles, times, max_range=max_range)
        ranges = at_edges(ranges, middle, np.stack(sides), noise, rng)
    if noise.false_return > 0:
        ranges = with_false_returns(ranges, noise, rng)
    return ranges


def at_edges(
    ranges: NDArray[np.float32],
    middle: NDArray[np.float32],
    sides: NDArray[np.float32],
    noise: LidarNoise,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """What beams tell whose sides meet something else than their middle.

    On one flat surface the sides lie about as far before the middle as behind it; at an edge one of them does not.

    Args:
        ranges: [n] what the beams would tell as lines [m].
        middle: [n] where their middles end; sides: [2, n] where their sides end [m].
        noise: of the lidar.
        rng: drawn from, two numbers a beam.
    """
    with np.errstate(invalid="ignore"):
        step = np.abs(sides - middle)
        bend = np.abs(sides[0] + sides[1] - 2 * middle)
        edge = np.isfinite(ranges) & np.isfinite(middle) & ~(bend <= EDGE) & (step.max(0) > EDGE)
    which = (step[1] > step[0]).astype(np.int64)
    which = np.where(np.isfinite(step).all(0), which, np.where(np.isfinite(step[0]), 1, 0))
    other = np.take_along_axis(sides, which[None], axis=0)[0]
    share, chance = rng.random((2, len(ranges)), np.float32)
    with np.errstate(invalid="ignore"):
        apart = np.abs(other - middle)
        melted = middle + share * (other - middle)
        mixes = (chance < noise.mixed) & (apart <= noise.pulse)
    # a quarter of the beam's width lies on the other side of the edge, on average
    alone = np.where((share < 0.25) & np.isfinite(other), other, ranges)
    return np.where(edge, np.where(mixes, melted, alone), ranges).astype(np.float32)


def with_false_returns(ranges: NDArray[np.float32], noise: LidarNoise, rng: np.random.Generator) -> NDArray[np.float32]:
    """Ranges [n], some of them cut short by what floats in the air (z_short of Probabilistic Robotics, table 6.1)."""
    met = rng.random(len(ranges), np.float32) < noise.false_return
    drop = noise.range_min + rng.exponential(noise.false_scale, len(ranges))
    return np.where(met & ~(drop >= ranges), drop, ranges).astype(np.float32)
