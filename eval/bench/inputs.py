"""What the tasks work on: worlds, scans and maps, the same on every computer."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.kernels.thinning import ThinnedScan, thin_scan
from moteslam.kernels.tiles import Tiles
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps

Array = NDArray[np.float64]

BEAMS = 1081
CELLS, CELL = 2000, 0.05
"""Of the grid: how many in each direction, and how large [m]."""
ROOM = (8.0, 6.0)
"""Length and width of the room that the particles have maps of [m]."""
PARTICLES = 1000
FEW_BEAMS = 180
"""Of the scan that is registered to these maps, integrated into them and searched for in them."""
MOVED = np.array((0.1, -0.1, 0.2))
"""From where a particle is taken to be to where its scan was taken [m], [rad]."""
LINE = 64
"""Bytes that processors read from memory at once."""


def offices(segments: int = 500, *, size: float = 90.0, seed: int = 1) -> Array:
    """Rooms on a grid with gaps for doors, as ``segments`` walls [m, 4] [m]."""
    generator = np.random.default_rng(seed)
    room, rows = 6.0, []
    for i in range(int(size / room) + 1):
        for j in range(int(size / room)):
            a, b = sorted(generator.uniform(0.5, room - 0.5, 2))
            at, low = i * room, j * room
            rows += [(at, low, at, low + a), (at, low + b, at, low + room)]
            rows += [(low, at, low + a, at), (low + b, at, low + room, at)]
    return np.array(rows)[generator.permutation(len(rows))[:segments]]


def scan_and_grid(seed: int = 0) -> tuple[NDArray[np.uint8], Array]:
    """A grid of walls [CELLS, CELLS] with a border of zeros, and a scan's points [BEAMS, 2] [m] on them."""
    grid = np.zeros((CELLS, CELLS), np.uint8)
    grid[600:1400:160, 400:1600] = 1
    grid[600:1400, 400:1600:200] = 1
    angles = np.linspace(np.radians(-135), np.radians(135), BEAMS)
    ranges = np.minimum(4.0 / np.maximum(np.abs(np.cos(angles)), 1e-3), 4.9 / np.maximum(np.abs(np.sin(angles)), 1e-3))
    ranges += np.random.default_rng(seed).normal(0, 0.01, BEAMS)
    return grid, np.stack((ranges * np.cos(angles), ranges * np.sin(angles)), axis=-1)


def room_scan(pose: ArrayLike, beams: int) -> ThinnedScan:
    """A scan of a room, all around, from a pose given from the room's middle, as it is registered and integrated."""
    x, y, theta = np.asarray(pose, np.float64)
    angles = np.linspace(-np.pi, np.pi, beams, endpoint=False) + 0.001
    across, up = np.cos(angles + theta), np.sin(angles + theta)
    ranges = np.minimum((np.sign(across) * ROOM[0] / 2 - x) / across, (np.sign(up) * ROOM[1] / 2 - y) / up)
    points = ranges[:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
    return thin_scan(points, (0.0, 0.0), spacing=0.02, gap=0.3, gap_from_range=0.05)


def room_poses() -> Array:
    """Where the particles are taken to be, [PARTICLES, 3]: about the middle of the room."""
    return np.random.default_rng(10).normal(0, (0.05, 0.05, 0.02), (PARTICLES, 3))


def map_config() -> TsdfConfig:
    """Of the particles' maps."""
    return TsdfConfig(cell_size=CELL, truncation=0.15, coarse_truncation=0.4)


def room_maps() -> tuple[TsdfMaps, ThinnedScan]:
    """A map of the room for every particle, in tiles of its own, and the scan that was integrated last."""
    maps, scan = TsdfMaps(map_config()), room_scan(MOVED, FEW_BEAMS)
    maps.integrate(np.zeros((1, 3)), room_scan(np.zeros(3), 2 * FEW_BEAMS))
    maps.resample(np.zeros(PARTICLES, np.int64))
    maps.integrate(room_poses() + MOVED, scan)  # each copies the tiles that it writes to
    return maps, scan


def in_arrays(tiles: Tiles) -> tuple[NDArray[Any], NDArray[Any], int, int]:
    """Maps as the C loops take them: the pool, the tables one after the other, and their rows and columns."""
    return tiles.pool, tiles.table, tiles.rows, tiles.columns


def lines(addresses: NDArray[Any], size: int) -> int:
    """How many bytes the cache lines of array elements take together.

    Args:
        addresses: the elements' indices, of any shape; any of them may come several times.
        size: of an element [bytes].
    """
    return LINE * len(np.unique(addresses.astype(np.int64) * size // LINE))
