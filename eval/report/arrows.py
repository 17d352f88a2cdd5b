"""Arrows along the lines of a floor plan, and places at even distances on them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes

APART = 0.9
"""Distance between the arrows along a line [inch]."""
LENGTH, HALF_WIDTH = 0.11, 0.035
"""Of an arrow [inch]."""
BESIDE = 0.05
"""How far to the right of the line an arrow is drawn [inch]: there and back differ."""


def draw_arrows(axes: Axes, line: NDArray[np.float64], scale: float, colour: str) -> None:
    """Arrows beside a line [k, 2] [m], at even distances and to the right of it.

    Args:
        axes: of the plan.
        line: corners.
        scale: of the plan [inch/m].
        colour: of the arrows.
    """
    from matplotlib.collections import PolyCollection

    places, directions = along(line, APART / scale)
    right = np.stack((directions[:, 1], -directions[:, 0]), axis=-1)
    middle = places + BESIDE / scale * right
    corners = [middle + LENGTH / 2 / scale * directions]
    corners += [middle - (LENGTH / 2 * directions + side * HALF_WIDTH * right) / scale for side in (-1, 1)]
    axes.add_collection(PolyCollection(list(np.stack(corners, axis=1)), facecolors=colour, edgecolors="none", zorder=3))


def along(line: NDArray[np.float64], spacing: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Places [n, 2] on a line [k, 2] at even distances, at least one, and the line's unit directions there [n, 2].

    Args:
        line: two corners at least, in any unit.
        spacing: about this distance between two places.
    """
    steps = np.diff(line, axis=0)
    lengths = np.hypot(*steps.T)
    travelled = np.concatenate(([0.0], np.cumsum(lengths)))
    count = max(1, round(travelled[-1] / spacing))
    at = (np.arange(count) + 0.5) * travelled[-1] / count
    leg = np.clip(np.searchsorted(travelled, at, side="right") - 1, 0, len(steps) - 1)
    directions = steps[leg] / np.maximum(lengths[leg], 1e-12)[:, None]
    return line[leg] + (at - travelled[leg])[:, None] * directions, directions
