"""Where the first echo of a beam comes from, in a world of glass, black and shiny surfaces, people and doors.

A beam is followed from surface to surface: plain ones and people end it; through glass it goes straight on, from a
mirror it goes on mirrored, and its range is the length of the complete path. Beams are as wide as they are: edges
mix two ranges.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.noise import LidarNoise
from moteslam.robot.se2 import Array
from moteslam.sim.actors.actors import Tracks
from moteslam.sim.world.pieces import Material
from moteslam.sim.world.world import World

MAX_SURFACES = 4  # That a beam is followed to
BEYOND = 1e-3  # A beam goes on this far behind a pane or before a mirror [m]: what stands closer to them is missed


class Rays(NamedTuple):
    origins: Array  # [n, 2] where each begins [m]
    angles: Array  # [n] its direction [rad]
    times: Array  # [n] its moment since the drive's start [s]


@dataclass(frozen=True, eq=False)
class Scene:
    """A world with what moves in it."""

    world: World
    tracks: Tracks | None = None

    @property
    def is_plain(self) -> bool:
        """Whether every surface gives an echo and nothing moves."""
        return self.tracks is None and self.world.surfaces is None

    def exact(self, rays: Rays, *, max_range: float) -> NDArray[np.float32]:
        """The range [n] to the first thing of any kind [m], ``inf`` beyond max_range, as if nothing were glass."""
        from moteslam.kernels.raycast import cast_rays

        ranges, _ = cast_rays(self.world.buckets, rays.origins, rays.angles, max_range=max_range)
        if self.tracks is not None:
            self._meet(rays, ranges)
        return ranges

    def echoes(self, rays: Rays, rng: np.random.Generator, *, max_range: float) -> NDArray[np.float32]:
        """The range [n] of the first echo [m]: ``inf`` where none comes, ``nan`` where it is of no use."""
        if self.is_plain:
            return self.exact(rays, max_range=max_range)
        origins, angles, times = rays
        measured = np.full(len(origins), np.inf, np.float32)
        index, before = np.arange(len(origins)), np.zeros(len(origins))
        for _ in range(MAX_SURFACES):
            ranges, surface, normal = self._first(Rays(origins, angles, times), max_range)
            length = before + ranges
            fate = self._fate(surface, normal, angles, length, rng)
            measured[index[fate == SEEN]] = length[fate == SEEN]
            measured[index[fate == USELESS]] = np.nan
            on = (fate == PASSES) | (fate == MIRRORED)
            on &= length + BEYOND < max_range
            if not on.any():
                break
            ahead = np.stack((np.cos(angles), np.sin(angles)), axis=-1)[on]
            turned = np.where((fate == MIRRORED)[on], 2 * normal[on] + np.pi - angles[on], angles[on])
            onward = np.stack((np.cos(turned), np.sin(turned)), axis=-1)
            step = ranges[on].astype(np.float64)
            origins, angles = origins[on] + step[:, None] * ahead + BEYOND * onward, turned
            index, times, before = index[on], times[on], before[on] + step + BEYOND
        measured[measured > max_range] = np.inf
        return measured

    def _first(self, rays: Rays, max_range: float) -> tuple[NDArray[np.float32], NDArray[np.int64], Array]:
        """Range, material and direction of the normal of the first surface of each beam; material -1 for none."""
        from moteslam.kernels.raycast import cast_rays

        world = self.world
        ranges, segment = cast_rays(world.buckets, rays.origins, rays.angles, max_range=max_range)
        kinds = np.zeros(len(world.segments), np.int64) if world.surfaces is None else world.surfaces
        surface = np.where(segment >= 0, kinds[segment], -1)
        along = world.segments[:, 2:] - world.segments[:, :2]
        normal = (np.arctan2(along[:, 1], along[:, 0]) + np.pi / 2)[segment]
        tracks = self.tracks
        if tracks is not None:
            met = self._meet(rays, ranges)
            surface = np.where(met >= 0, PERSON, surface)
            discs = tracks.discs.shape[1]
            leaf = np.flatnonzero(met >= discs)
            surface[leaf] = tracks.surfaces[met[leaf] - discs]
            row = np.clip(np.round((rays.times[leaf] - tracks.begin) * tracks.rate), 0, len(tracks.lines) - 1).astype(
                np.int64
            )
            ends = tracks.lines[row, met[leaf] - discs]
            normal[leaf] = np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0]) + np.pi / 2
        return ranges, surface.astype(np.int64), normal

    def _meet(self, rays: Rays, ranges: NDArray[np.float32]) -> NDArray[np.int32]:
        """Shorten the ranges to what moves; which disc or leaf that is, or -1."""
        from moteslam.kernels.raycast import cast_movers

        tracks = self.tracks
        assert tracks is not None
        rays = rays._replace(times=rays.times - tracks.begin)
        return cast_movers(tracks.discs, tracks.lines, tracks.rate, *rays, ranges)

    def _fate(
        self, surface: NDArray[np.int64], normal: Array, angles: Array, length: Array, rng: np.random.Generator
    ) -> NDArray[np.int8]:
        """What becomes of each beam at its surface, after a path of some length [m]."""
        fate = np.where(surface >= 0, SEEN, LOST).astype(np.int8)
        fate[surface == PERSON] = SEEN
        draws = rng.random((len(fate), 3))
        for i, material in enumerate(self.world.palette.values()):
            here = np.flatnonzero(surface == i)
            if len(here) and material != Material():
                # from the normal, on whichever side: 0 to pi / 2
                off = np.abs(np.arcsin(np.clip(np.sin(angles[here] - normal[here]), -1.0, 1.0)))
                fate[here] = _fate_at(material, off, length[here], draws[here])
        return fate


LOST, SEEN, USELESS, PASSES, MIRRORED = range(5)
PERSON = -2


def _fate_at(material: Material, off: Array, length: Array, draws: Array) -> NDArray[np.int8]:
    """What becomes of beams that meet a material at an angle ``off`` its normal [rad], after ``length`` metres."""
    lobe = np.exp(-((off / material.lobe) ** 2))
    passes = draws[:, 0] < material.passes + (material.passes_square - material.passes) * lobe
    mirrored = (draws[:, 1] < material.mirrors) & (off > material.lobe)
    useless = draws[:, 2] < material.dropout
    fate = np.where(passes, PASSES, np.where(mirrored, MIRRORED, np.where(useless, USELESS, SEEN))).astype(np.int8)
    if material.reach is not None:
        faint = length > material.reach * np.sqrt(np.cos(off))
        fate[faint & ((fate == SEEN) | (fate == USELESS))] = LOST
    return fate


EDGE = 0.1  # Smallest distance between the two sides of an edge, beyond the slope of the surface [m]


def mix_at_edges(
    ranges: NDArray[np.float32],
    middle: NDArray[np.float32],
    sides: NDArray[np.float32],
    noise: LidarNoise,
    rng: np.random.Generator,
) -> NDArray[np.float32]:
    """The ranges [n] of beams, some of whose ``sides`` [2, n] meet something else than their ``middle`` [n] [m].

    On one flat surface the sides lie about as far before the middle as behind it; at an edge one of them does not.
    There, with probability ``noise.mixed``, the two echoes melt into one in between, if they are at most
    ``noise.pulse`` [m] apart; otherwise the range is that of one of them. Two numbers a beam are drawn from ``rng``.
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
        melts = (draw < noise.mixed) & (apart <= noise.pulse)
    # a quarter of the beam's width lies on the other side of the edge, on average
    alone = np.where((share < 0.25) & np.isfinite(other), other, ranges)
    return np.where(edge, np.where(melts, melted, alone), ranges).astype(np.float32)
