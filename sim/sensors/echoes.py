"""Where the first echo of a beam comes from, in a world of glass, black and shiny surfaces, people and doors.

A beam is followed from surface to surface: plain ones and people end it; through glass it goes straight on, from a
mirror it goes on mirrored, and what comes back tells the length of the whole way. After ``MOST`` surfaces it is lost.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.sim.materials import Material
from moteslam.sim.movers import Movers
from moteslam.sim.world import World

MOST = 4
"""Surfaces that a beam is followed to."""
BEYOND = 1e-3
"""A beam goes on so far from a surface [m]: what stands closer behind a pane, or before a mirror, is not seen."""

Floats = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Scene:
    """A world with what moves in it, ready for rays.

    Args:
        world: what stands.
        movers: what moves, None for nothing.
    """

    world: World
    movers: Movers | None = None

    def __post_init__(self) -> None:
        from moteslam.kernels.raycast import build_buckets

        object.__setattr__(self, "_buckets", build_buckets(self.world.segments))

    @property
    def is_plain(self) -> bool:
        """Whether every surface gives an echo and nothing moves."""
        return self.movers is None and self.world.surfaces is None

    def exact(self, origins: Floats, angles: Floats, times: Floats, *, max_range: float) -> NDArray[np.float32]:
        """The range [n] to the first thing of any kind [m], ``inf`` beyond max_range, as if nothing were glass."""
        from moteslam.kernels.raycast import cast_rays

        ranges = cast_rays(self._buckets, origins, angles, max_range=max_range)  # type: ignore[attr-defined]
        if self.movers is not None:
            self._meet(origins, angles, times, ranges)
        return ranges

    def echoes(
        self, origins: Floats, angles: Floats, times: Floats, rng: np.random.Generator, *, max_range: float
    ) -> NDArray[np.float32]:
        """The range [n] that the first echo tells [m]: ``inf`` where none comes, ``nan`` where it is of no use.

        Args:
            origins: [n, 2] where each beam begins [m].
            angles: [n] its direction [rad].
            times: [n] its moment since the drive's start [s].
            rng: drawn from.
            max_range: beyond which nothing comes back [m].
        """
        if self.is_plain:
            return self.exact(origins, angles, times, max_range=max_range)
        told = np.full(len(origins), np.inf, np.float32)
        index, before = np.arange(len(origins)), np.zeros(len(origins))
        origins, angles = np.array(origins), np.array(angles)
        for _ in range(MOST):
            ranges, surface, normal = self._first(origins, angles, times, max_range)
            whole = before + ranges
            fate = self._fate(surface, normal, angles, whole, rng)
            told[index[fate == SEEN]] = whole[fate == SEEN]
            told[index[fate == USELESS]] = np.nan
            on = (fate == PASSES) | (fate == MIRRORED)
            on &= whole + BEYOND < max_range
            if not on.any():
                break
            ahead = np.stack((np.cos(angles), np.sin(angles)), axis=-1)[on]
            turned = np.where((fate == MIRRORED)[on], 2 * normal[on] + np.pi - angles[on], angles[on])
            onward = np.stack((np.cos(turned), np.sin(turned)), axis=-1)
            step = ranges[on].astype(np.float64)
            origins, angles = origins[on] + step[:, None] * ahead + BEYOND * onward, turned
            index, times, before = index[on], times[on], before[on] + step + BEYOND
        told[told > max_range] = np.inf
        return told

    def _first(
        self, origins: Floats, angles: Floats, times: Floats, max_range: float
    ) -> tuple[NDArray[np.float32], NDArray[np.int64], Floats]:
        """Range, material and direction of the normal of the first surface of each beam; material -1 for none."""
        from moteslam.kernels.raycast import cast_surfaces

        world = self.world
        ranges, segment = cast_surfaces(self._buckets, origins, angles, max_range=max_range)  # type: ignore[attr-defined]
        kinds = np.zeros(len(world.segments), np.int64) if world.surfaces is None else world.surfaces
        surface = np.where(segment >= 0, kinds[segment], -1)
        along = world.segments[:, 2:] - world.segments[:, :2]
        normal = (np.arctan2(along[:, 1], along[:, 0]) + np.pi / 2)[segment]
        if self.movers is not None:
            met = self._meet(origins, angles, times, ranges)
            surface = np.where(met >= 0, PERSON, surface)
            discs = self.movers.discs.shape[1]
            leaf = np.flatnonzero(met >= discs)
            surface[leaf] = self.movers.surfaces[met[leaf] - discs]
            row = np.clip(np.round(times[leaf] * self.movers.rate), 0, len(self.movers.lines) - 1).astype(np.int64)
            ends = self.movers.lines[row, met[leaf] - discs]
            normal[leaf] = np.arctan2(ends[:, 3] - ends[:, 1], ends[:, 2] - ends[:, 0]) + np.pi / 2
        return ranges, surface.astype(np.int64), normal

    def _meet(self, origins: Floats, angles: Floats, times: Floats, ranges: NDArray[np.float32]) -> NDArray[np.int32]:
        from moteslam.kernels.movers import cast_movers

        movers = self.movers
        assert movers is not None
        return cast_movers(movers.discs, movers.lines, movers.rate, origins, angles, times, ranges)

    def _fate(
        self, surface: NDArray[np.int64], normal: Floats, angles: Floats, whole: Floats, rng: np.random.Generator
    ) -> NDArray[np.int8]:
        """What becomes of each beam at its surface."""
        fate = np.where(surface >= 0, SEEN, LOST).astype(np.int8)
        fate[surface == PERSON] = SEEN
        draws = rng.random((len(fate), 3))
        for i, material in enumerate(self.world.palette):
            here = np.flatnonzero(surface == i)
            if len(here) and material != Material():
                # from the normal, on whichever side: 0 to pi / 2
                off = np.abs(np.arcsin(np.clip(np.sin(angles[here] - normal[here]), -1.0, 1.0)))
                fate[here] = _fate_at(material, off, whole[here], draws[here])
        return fate


LOST, SEEN, USELESS, PASSES, MIRRORED = range(5)
PERSON = -2


def _fate_at(material: Material, off: Floats, whole: Floats, draws: Floats) -> NDArray[np.int8]:
    """What becomes of beams that meet a material at an angle ``off`` its normal [rad], after ``whole`` metres."""
    lobe = np.exp(-((off / material.lobe) ** 2))
    passes = draws[:, 0] < material.passes + (material.passes_square - material.passes) * lobe
    mirrored = (draws[:, 1] < material.mirrors) & (off > material.lobe)
    useless = draws[:, 2] < material.dropout
    fate = np.where(passes, PASSES, np.where(mirrored, MIRRORED, np.where(useless, USELESS, SEEN))).astype(np.int8)
    if material.reach is not None:
        faint = whole > material.reach * np.sqrt(np.cos(off))
        fate[faint & ((fate == SEEN) | (fate == USELESS))] = LOST
    return fate
