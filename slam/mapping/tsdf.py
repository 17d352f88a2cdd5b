"""A truncated signed distance function (TSDF) for every particle: tables of shared tiles that grow with the robot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.kernels.scans import ThinnedScan
from moteslam.kernels.tiles import CELLS, SIDE, Tiles, tile_store
from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans
from moteslam.robot.se2 import Array, Pose, as_pose
from moteslam.slam.mapping.config import TsdfConfig

TABLE_CHUNK = 8  # The tables grow by multiples of this many tiles
FIRST_TILES = 32  # Tiles of the pool to begin with; it doubles
MAX_TILES = 2**31 // CELLS  # More would need 64-bit addresses, and 4 GB
MAX_ENTRIES = 2**29  # Of all tables together: 2 GB
DRAWN = 64  # Scans that are drawn into a map at a time: the tables are made large enough for all of them before
PARTS = 2  # of the TSDFs are written one after the other, where one alone is looked at for as many scans


class TsdfMaps:
    """The TSDFs of N particles; a single one until the first resampling."""

    def __init__(self, config: TsdfConfig) -> None:
        self.config, self._options = config, IntegrationOptions(**config.model_dump())
        self._tile_size = SIDE * config.cell_size
        self._corner = np.array([-TABLE_CHUNK, -TABLE_CHUNK])  # the first tile of the tables: (column, row)
        self._store = tile_store(2 * TABLE_CHUNK, 2 * TABLE_CHUNK, FIRST_TILES)
        self._waiting: tuple[Array, ThinnedScan] | None = None  # poses [N, 3] and scan, to be averaged in ...
        self._left: list[range] = []  # ... to the TSDFs of these particles yet
        self._looks = 0  # at one of them since the scan came

    def __len__(self) -> int:
        return self._store.tiles.maps

    @property
    def memory(self) -> int:
        """Bytes taken by tiles and tables."""
        self._settle()
        return self._store.nbytes

    def all(self) -> TsdfView:
        """The TSDFs of all particles, to register to; valid until the next call."""
        self._settle()
        return self._view()

    def of(self, particle: int) -> TsdfView:
        """The TSDF of one particle, likewise."""
        self._looks += 1
        if self._left:
            has_it = (part for part in self._left if particle in part)
            self._write_waiting(next(has_it, self._left[0]))
        config, tiles, corner = self._view()
        return TsdfView(config, tiles.of(particle), corner)

    def _view(self) -> TsdfView:
        x, y = self._corner.tolist()
        return TsdfView(self.config, self._store.tiles, (x * self._tile_size, y * self._tile_size))

    def resample(self, parents: NDArray[np.int64]) -> None:
        """Give every particle the TSDF of its parent [M]; M is their number from now on.

        Raises ``InputError``: the tables would take more than ``MAX_ENTRIES``.
        """
        self._settle()
        self._check_entries(len(parents), self._store.tiles.rows, self._store.tiles.columns)
        self._store.resample(parents)

    def integrate(self, poses: Array, scan: ThinnedScan) -> None:
        """Average a scan in the robot's frame into every particle's TSDF, each from its own pose [N, 3] in the map
        frame.

        Fewer than two points have no surface. It is done once the TSDFs are looked at: who waits for the pose of the
        scan has it before. If one TSDF alone was looked at for several scans since the call before, the others are
        written in parts, one with each look: no scan waits for all of them. Then it is refused where tiles or tables
        would take more than ``MAX_TILES`` or ``MAX_ENTRIES``.
        """
        self._settle()
        n, parts = len(poses), min(max(self._looks, 1), PARTS, len(poses))
        self._waiting, self._looks = (poses, scan), 0
        self._left = [range(k * n // parts, (k + 1) * n // parts) for k in range(parts)]

    def _settle(self) -> None:
        if sum(map(len, self._left)) == len(self):
            self._left = [range(len(self))]
        while self._left:
            self._write_waiting(self._left[0])

    def _write_waiting(self, part: range) -> None:
        assert self._waiting is not None
        self._left.remove(part)
        poses, scan = self._waiting
        self._write(poses, [scan], part)

    def draw(self, poses: Array, scans: Sequence[ThinnedScan]) -> None:
        """Average m scans from poses [m, 3], ``DRAWN`` at a time and one after the other, into the one TSDF that there
        is.

        Raises ``InputError``: as of ``integrate``.
        """
        self._settle()
        for first in range(0, len(scans), DRAWN):
            self._write(poses[first : first + DRAWN], scans[first : first + DRAWN], range(1))

    def _write(self, poses: Array, scans: Sequence[ThinnedScan], part: range) -> None:
        """Average scans into the TSDFs of a part of the particles; of each of all there is a pose a scan."""
        if not all(some := [len(scan.points) >= 2 for scan in scans]):  # one point is no surface
            poses, scans = poses[np.flatnonzero(some)], [scan for scan, has in zip(scans, some, strict=True) if has]
        if not scans:
            return
        c = self.config
        farthest = max(float(np.hypot(*scan.points.T).max()) for scan in scans)
        self._cover(poses, farthest + 2 * max(c.truncation, c.coarse_truncation) + self._tile_size)
        frames = self._view().frames(poses if len(part) == len(self) else poses[part.start : part.stop])
        while not integrate_scans(self._store, frames, scans, options=self._options, part=part):
            self._make_room()

    def _cover(self, poses: Array, reach: float) -> None:
        """Grow the tables so that everything within ``reach`` [m] of the poses is inside."""
        rows, columns = self._store.tiles.rows, self._store.tiles.columns
        lowest, highest = poses[:, :2].min(axis=0).tolist(), poses[:, :2].max(axis=0).tolist()
        below, above = [], []
        for low, high, first, size in zip(lowest, highest, self._corner.tolist(), (columns, rows), strict=True):
            begin, end = (low - reach) // self._tile_size, (high + reach) // self._tile_size + 1
            below.append(int(max(0, -((begin - first) // TABLE_CHUNK))) * TABLE_CHUNK)
            above.append(int(max(0, -((first + size - end) // TABLE_CHUNK))) * TABLE_CHUNK)
        if not any(below) and not any(above):
            return
        wide, tall = columns + below[0] + above[0], rows + below[1] + above[1]
        self._check_entries(len(self), tall, wide)
        self._store.grow(tall, wide, below[1], below[0])
        self._corner = self._corner - below

    def _check_entries(self, particles: int, tall: int, wide: int) -> None:
        if particles * wide * tall > MAX_ENTRIES:
            raise InputError(
                f"{particles} tables of {wide} x {tall} tiles of {self._tile_size:g} m, expected at most "
                f"{MAX_ENTRIES:.0e} entries; fewer particles, larger cells or a smaller max_range help",
                field="particles",
            )

    def _make_room(self) -> None:
        """After copying tiles failed: collect the tiles that no particle names, and grow the pool if they are few."""
        self._store.count()
        capacity = self._store.capacity
        if 3 * self._store.left >= capacity:
            return
        if 2 * capacity > MAX_TILES:
            raise InputError(
                f"{capacity} tiles of {len(self)} particles' maps are full, expected fewer particles, larger cells or "
                "a smaller max_range",
                field="particles",
            )
        self._store.enlarge()


class TsdfView(NamedTuple):
    """The TSDFs of some of the particles."""

    config: TsdfConfig  # cell size and truncations
    tiles: Tiles  # of n particles
    corner: tuple[float, float]  # (x, y) of the tables' first tile [m]

    def reach(self, pose: Array) -> float:
        """How far from a pose the map reaches [m]: beyond it no endpoint is known, however long a lapse lasts."""
        size = SIDE * self.config.cell_size * np.array((self.tiles.columns, self.tiles.rows))
        off = np.asarray(pose[:2]) - self.corner
        return float(np.hypot(*np.maximum(np.abs(off), np.abs(off - size))))

    def frame(self, pose: Pose) -> tuple[float, float, float, float]:
        """A pose as the kernels take it: cos, sin, x, y [m] from the tables' corner."""
        (x, y, theta), (left, below) = pose, self.corner
        return math.cos(theta), math.sin(theta), x - left, y - below

    def frames(self, poses: Array) -> Array:
        """Poses [N, 3] likewise, [N, 4]."""
        if len(poses) == 1:  # in a fifth of the time that arrays of one element take
            return np.array((self.frame(as_pose(poses[0])),))
        frames = np.empty((len(poses), 4))
        frames[:, 0], frames[:, 1] = np.cos(poses[:, 2]), np.sin(poses[:, 2])
        frames[:, 2:] = poses[:, :2] - self.corner
        return frames
