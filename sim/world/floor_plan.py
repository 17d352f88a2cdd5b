"""Floor plans, of map_server or as arrays of log-odds, as worlds: the sides of occupied cells are walls."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from moteslam.errors import InputError
from moteslam.robot.formats.map_arrays import read_map_arrays
from moteslam.robot.formats.map_server import FREE, MAX_EXTENT, MAX_PIXELS, OCCUPIED, read_map, trinary
from moteslam.robot.formats.npz import is_archive
from moteslam.robot.raster import Raster
from moteslam.robot.tables import Section


class FloorPlan(Section):
    """A floor plan: the ``.yaml`` file of map_server, or an ``.npz`` of log-odds, and what its unknown cells are.

    Attributes:
        file: relative to the scenario's own folder; in it or below.
        unknown: ``free``: only occupied cells have walls; ``wall``: unknown ones too.
    """

    file: Annotated[str, Field(min_length=1, max_length=4096)]
    unknown: Literal["free", "wall"] = "free"


def read_floor_plan(plan: FloorPlan) -> Raster:
    """The solid cells of a floor plan, as bools; read once until the file changes.

    Raises:
        InputError: files that cannot be read (`read_map`, `read_map_arrays`), or no occupied cell; file and key are
            named.
    """
    try:
        stamp = Path(plan.file).stat().st_mtime_ns
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(
            f"{reason}, expected a map_server .yaml file or an .npz of log-odds", file=plan.file
        ) from error
    return _read(plan, stamp)


def read_cells(plan: FloorPlan) -> Raster:
    """The free, occupied and unknown cells of a floor plan, as `read_map` has them.

    Raises:
        InputError: files that cannot be read.
    """
    path = Path(plan.file)
    return _of_arrays(path) if is_archive(path) else read_map(path)


@lru_cache(maxsize=8)
def _read(plan: FloorPlan, _stamp: int) -> Raster:
    path = Path(plan.file)
    known = read_cells(plan)
    solid = known.values != FREE if plan.unknown == "wall" else known.values == OCCUPIED
    if not solid.any():
        raise InputError(
            "no occupied cell, expected walls", file=path, field="log_odds" if is_archive(path) else "image"
        )
    solid.setflags(write=False)
    return Raster(solid, known.cell_size, known.origin)


def _of_arrays(path: Path) -> Raster:
    """The free, occupied and unknown cells of a map of log-odds."""
    found = read_map_arrays(path)
    if found.kind != "log_odds":
        raise InputError(f"{found.kind!r}, expected log_odds", file=path, field="header.kind")
    log_odds = found.raster("log_odds")
    rows, columns = log_odds.shape
    if rows * columns > MAX_PIXELS or max(rows, columns) * log_odds.cell_size > MAX_EXTENT:
        bounds = f"expected at most {MAX_PIXELS} in all and {MAX_EXTENT:g} m a side"
        raise InputError(f"{columns} x {rows} cells of {log_odds.cell_size:g} m, {bounds}", file=path, field="log_odds")
    return Raster(trinary(log_odds.values), log_odds.cell_size, log_odds.origin)
