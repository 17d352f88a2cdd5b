"""Floor plans, of map_server or as arrays of log-odds, as worlds: the sides of occupied cells are walls."""

from __future__ import annotations

import zipfile
from contextlib import suppress
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.errors import InputError
from moteslam.robot.formats.map_server import FREE, MAX_EXTENT, MAX_PIXELS, OCCUPIED, read_map, trinary
from moteslam.robot.raster import Raster, read_map_arrays
from moteslam.robot.values import Section
from moteslam.sim.world.pieces import Segments


def wall_segments(solid: Raster) -> Segments:
    """The sides between solid cells (bools [H, W]) and others [m, 4] [m], each run of them in one piece."""
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


class FloorPlan(Section):
    """A floor plan: the ``.yaml`` file of map_server, or an ``.npz`` of log-odds, in the scenario's folder or below.

    ``unknown`` cells are ``free`` (only occupied cells have walls) or a ``wall``.
    """

    file: Annotated[str, Field(min_length=1, max_length=4096)]
    unknown: Literal["free", "wall"] = "free"


def read_floor_plan(plan: FloorPlan) -> Raster:
    """The solid cells of a floor plan, as bools; read once until the file changes."""
    stamp = 0
    with suppress(OSError, ValueError):  # reading the file says what is wrong with it
        stamp = Path(plan.file).stat().st_mtime_ns
    return _read(plan, stamp)


def read_cells(plan: FloorPlan) -> Raster:
    """The free, occupied and unknown cells of a floor plan, as `read_map` has them."""
    path = Path(plan.file)
    return _of_arrays(path) if _is_archive(path) else read_map(path)


def _is_archive(path: Path) -> bool:
    return path.is_file() and zipfile.is_zipfile(path)


@lru_cache(maxsize=8)
def _read(plan: FloorPlan, _stamp: int) -> Raster:
    path = Path(plan.file)
    known = read_cells(plan)
    solid = known.values != FREE if plan.unknown == "wall" else known.values == OCCUPIED
    if not solid.any():
        field = "log_odds" if _is_archive(path) else "image"
        raise InputError("no occupied cell, expected walls", file=path, field=field)
    solid.setflags(write=False)
    return Raster(solid, known.cell_size, known.origin)


def _of_arrays(path: Path) -> Raster:
    """The free, occupied and unknown cells of a map of log-odds."""
    log_odds = read_map_arrays(path)
    rows, columns = log_odds.shape
    if rows * columns > MAX_PIXELS or max(rows, columns) * log_odds.cell_size > MAX_EXTENT:
        bounds = f"expected at most {MAX_PIXELS} in all and {MAX_EXTENT:g} m a side"
        raise InputError(f"{columns} x {rows} cells of {log_odds.cell_size:g} m, {bounds}", file=path, field="log_odds")
    return Raster(trinary(log_odds.values), log_odds.cell_size, log_odds.origin)
