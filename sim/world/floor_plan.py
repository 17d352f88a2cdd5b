"""Floor plans as map_server keeps them, as worlds: the sides of occupied cells are walls."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field

from moteslam.errors import InputError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, read_map
from moteslam.robot.raster import Raster
from moteslam.robot.section import Section


class FloorPlan(Section):
    """A floor plan: the ``.yaml`` file of map_server, and what its unknown cells are.

    Attributes:
        file: relative to the scenario's own folder.
        unknown: ``free``: only occupied cells have walls; ``wall``: unknown ones too.
    """

    file: Annotated[str, Field(min_length=1, max_length=4096)]
    unknown: Literal["free", "wall"] = "free"


def read_floor_plan(plan: FloorPlan) -> Raster:
    """The solid cells of a floor plan, as bools; read once until the file changes.

    Raises:
        InputError: files that cannot be read (see `read_map`), or no occupied cell; file and key are named.
    """
    try:
        stamp = Path(plan.file).stat().st_mtime_ns
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{reason}, expected a map_server .yaml file", file=plan.file) from error
    return _read(plan, stamp)


@lru_cache(maxsize=8)
def _read(plan: FloorPlan, _stamp: int) -> Raster:
    known = read_map(plan.file)
    solid = known.values != FREE if plan.unknown == "wall" else known.values == OCCUPIED
    if not solid.any():
        raise InputError("no occupied cell, expected walls", file=plan.file, field="image")
    solid.setflags(write=False)
    return Raster(solid, known.cell_size, known.origin)
