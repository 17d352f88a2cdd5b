"""What floors are made of: tiles, carpet, wood or plain colour as arithmetic, in world metres at any resolution."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from moteslam.sim.world.value_noise import Array, cell_noise, smooth_noise

Rgb = tuple[int, int, int]
JOINT = 0.005
"""Half a joint between tiles [m]."""


@dataclass(frozen=True)
class Pattern:
    """A material of a floor.

    Attributes:
        draw: ``draw(x, y, size, palette, seed)``: colours [n, 3] (0 to 255, not clipped) at x, y [n] [m], from a
            palette [k, 3].
        size: usual size of a tile, blotch or plank [m].
        palette: usual colours.
    """

    draw: Callable[[Array, Array, float, Array, int], Array]
    size: float
    palette: tuple[Rgb, ...]


def _tiles(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    col, row = np.floor(x / size), np.floor(y / size)
    colours = _pick(palette, col, row, seed, 1)
    shade = 0.9 + 0.2 * cell_noise(col, row, seed, 2) + 0.08 * (smooth_noise(x / 0.05, y / 0.05, seed, 3) - 0.5)
    off_x, off_y = np.abs(x - (col + 0.5) * size), np.abs(y - (row + 0.5) * size)
    colours *= shade[:, None]
    colours[np.maximum(off_x, off_y) > size / 2 - JOINT] = 96.0
    return np.asarray(colours)


def _carpet(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    level = smooth_noise(x / size, y / size, seed, 1) + 0.4 * smooth_noise(2.7 * x / size, 2.7 * y / size, seed, 2)
    rank = np.clip((level - 0.25) / 0.9, 0, 0.999)  # most of the noise lies there
    colours = palette[(rank * len(palette)).astype(np.int64)]
    pile = 0.8 + 0.4 * cell_noise(np.floor(x / 0.01), np.floor(y / 0.01), seed, 3)
    return np.asarray(colours * pile[:, None])


def _wood(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    length = 8 * size
    row = np.floor(y / size)
    along = x / length + cell_noise(row, row, seed, 1)  # each row is staggered by its own share of a plank
    plank = np.floor(along)
    colours = _pick(palette, plank, row, seed, 2)
    grain = 0.85 + 0.3 * smooth_noise(x / 0.25, y / 0.012, seed, 3)
    edge = np.minimum((along - plank) * length, y - row * size) < 0.003
    return np.where(edge[:, None], 20.0, colours * grain[:, None])


def _plain(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    shade = 0.95 + 0.1 * smooth_noise(x / 0.05, y / 0.05, seed, 1)
    return np.asarray(palette[0] * shade[:, None])


def _pick(palette: Array, col: Array, row: Array, seed: int, layer: int) -> Array:
    """The colour [n, 3] of the palette that each lattice cell has."""
    return np.asarray(palette[(cell_noise(col, row, seed, layer) * len(palette)).astype(np.int64)])


PATTERNS = {
    "tiles": Pattern(
        _tiles, 0.5, ((238, 232, 218), (176, 92, 66), (52, 60, 74), (128, 146, 112), (24, 24, 28), (208, 178, 120))
    ),
    "carpet": Pattern(_carpet, 0.8, ((34, 52, 96), (196, 176, 140), (122, 30, 40))),
    "wood": Pattern(_wood, 0.14, ((150, 98, 54), (110, 66, 34), (186, 136, 84), (84, 50, 28), (206, 168, 118))),
    "plain": Pattern(_plain, 1.0, ((128, 126, 122),)),
}
"""The patterns by name."""


def stain_shade(x: Array, y: Array, share: float, seed: int) -> Array:
    """The share of the light [n], 0.45 to 1, that stains leave: dark where smooth noise is in its top ``share``."""
    from scipy.special import ndtri

    level = (smooth_noise(x / 0.7, y / 0.7, seed, 8) + 0.5 * smooth_noise(x / 0.2, y / 0.2, seed, 9)) / 1.5
    # the noise is near to a normal distribution of this mean and spread (measured)
    threshold = 0.5 + 0.17 * float(ndtri(1 - min(share, 1 - 1e-9)))
    return np.asarray(1 - 0.55 * np.clip((level - threshold) / 0.04, 0, 1))
