"""The sides of solid cells as segments: what a lidar sees of a raster."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.raster import Raster
from moteslam.sim.world.geometry import Segments


def wall_segments(solid: Raster) -> Segments:
    """The sides between solid cells and others [m, 4] [m], each run of them in one piece.

    Args:
        solid: bool values [H, W].
    """
    return solid.to_world(trace_sides(solid.values).reshape(-1, 2)).reshape(-1, 4)


def trace_sides(cells: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The sides between solid cells and others, outside included: [m, 4] x0, y0, x1, y1 in cells.

    Sides that touch and lie in line are one segment, as long as the solid cells are on the same side of it.
    """
    padded = np.pad(cells, 1)
    # +1 where a solid cell begins, -1 where one ends, looking along an axis
    level = padded[1:, 1:-1].astype(np.int8) - padded[:-1, 1:-1]  # [rows + 1, cols]: sides along x
    upright = (padded[1:-1, 1:].astype(np.int8) - padded[1:-1, :-1]).T  # [cols + 1, rows]: sides along y
    along_x, along_y = _runs(level), _runs(upright)
    flat = np.stack((along_x[:, 1], along_x[:, 0], along_x[:, 2], along_x[:, 0]), axis=-1)
    tall = np.stack((along_y[:, 0], along_y[:, 1], along_y[:, 0], along_y[:, 2]), axis=-1)
    return np.concatenate((flat, tall)).astype(np.float64)


def _runs(lines: NDArray[np.int8]) -> NDArray[np.int64]:
    """Runs of equal numbers other than 0 in each line: [k, 3] line, first, one past the last."""
    padded = np.pad(lines, ((0, 0), (1, 1)))
    change = padded[:, 1:] != padded[:, :-1]
    begins = np.argwhere(change & (padded[:, 1:] != 0))
    ends = np.argwhere(change & (padded[:, :-1] != 0))
    return np.column_stack((begins, ends[:, 1]))
