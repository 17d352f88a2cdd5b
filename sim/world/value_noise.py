"""Value noise: random numbers on a lattice of whole coordinates, and what lies between them.

A value depends on its coordinates, the seed and the layer alone (a hash of the lattice point), never on what was asked
before: two rasters of the same noise agree wherever they overlap.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


def smooth_noise(u: Array, v: Array, seed: int, layer: int) -> Array:
    """Numbers [n] from 0 to 1 at (u, v) [n], uniform at whole coordinates and blended between them."""
    i, j = np.floor(u), np.floor(v)
    s, t = u - i, v - j
    s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
    (low_i, low_j), across = (i.min(), j.min()), int(np.ptp(i)) + 2
    if across * (np.ptp(j) + 2) <= 2 * len(u):  # points lie densely: hash each corner of the lattice once
        rows, columns = np.mgrid[0 : int(np.ptp(j)) + 2, 0:across].astype(np.float64)
        table = _hash(columns.reshape(-1) + low_i, rows.reshape(-1) + low_j, seed, layer)
        corner = ((j - low_j) * across + (i - low_i)).astype(np.int64)
        a, b, c, d = (table[corner + step] for step in (0, 1, across, across + 1))
    else:
        a, b, c, d = (_hash(i + right, j + up, seed, layer) for up in (0, 1) for right in (0, 1))
    below, above = a + s * (b - a), c + s * (d - c)
    return np.asarray(below + t * (above - below))


def cell_noise(i: Array, j: Array, seed: int, layer: int) -> Array:
    """Independent numbers in [0, 1) of the lattice cells (i, j) [n]."""
    low_i, low_j, across = i.min(), j.min(), int(np.ptp(i)) + 1
    if across * (np.ptp(j) + 1) > len(i) / 2:
        return _hash(i, j, seed, layer)
    # many points lie in the same cells: hash each cell once
    rows, columns = np.mgrid[0 : int(np.ptp(j)) + 1, 0:across].astype(np.float64)
    table = _hash(columns.reshape(-1) + low_i, rows.reshape(-1) + low_j, seed, layer)
    return np.asarray(table[((j - low_j) * across + (i - low_i)).astype(np.int64)])


def _hash(i: Array, j: Array, seed: int, layer: int) -> Array:
    """A number in [0, 1) for each lattice cell (i, j), layer and seed: a multiply-xor-shift hash of 64 bits."""
    key = np.uint64((seed * 0x9E3779B97F4A7C15 + layer * 0xD1B54A32D192ED03 + 0x8CB92BA72F3D8DD7) % 2**64)
    h = i.astype(np.int64).view(np.uint64) * np.uint64(0xBF58476D1CE4E5B9)
    h ^= j.astype(np.int64).view(np.uint64) * np.uint64(0x94D049BB133111EB) + key
    for shift, factor in ((30, 0xFF51AFD7ED558CCD), (31, 0xC4CEB9FE1A85EC53)):
        h ^= h >> np.uint64(shift)
        h *= np.uint64(factor)
    h ^= h >> np.uint64(32)
    return (h >> np.uint64(11)).astype(np.float64) * 2.0**-53
