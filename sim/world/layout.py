"""Everything that stands in a world, as it is written in a scenario's TOML file, floor plans included."""

import zipfile
from collections.abc import Iterator
from contextlib import suppress
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.errors import InputError
from moteslam.robot.formats.map_server import FREE, MAX_EXTENT, MAX_PIXELS, OCCUPIED, read_map, trinary
from moteslam.robot.raster import Raster, read_map_arrays
from moteslam.robot.se2 import Array
from moteslam.robot.values import NotNegative, Number, Positive, Section, Truth
from moteslam.sim.world.pieces import (
    MATERIALS,
    PLAIN,
    Box,
    Chair,
    Material,
    Pillar,
    Point,
    Segments,
    Shelf,
    Size,
    Table,
)


def wall_segments(solid: Raster) -> Segments:
    """The sides between solid cells (bools [H, W]) and others [m, 4] [m], each run of them in one piece."""
    return solid.to_world(trace_sides(solid.values).reshape(-1, 2)).reshape(-1, 4)


def trace_sides(cells: NDArray[np.bool_]) -> Array:
    """The sides between solid cells and others, outside included: [m, 4] x0, y0, x1, y1 in cells.

    Sides that touch and lie in line are one segment, as long as the solid cells are on the same side of it.
    """
    padded = np.pad(cells, 1)
    # +1 where a solid cell begins, -1 where one ends, looking along an axis
    level = padded[1:, 1:-1].astype(np.int8) - padded[:-1, 1:-1]  # [rows + 1, cols]: sides along x
    upright = (padded[1:-1, 1:].astype(np.int8) - padded[1:-1, :-1]).T  # [cols + 1, rows]: sides along y
    along_x, along_y = equal_runs(level), equal_runs(upright)
    flat = np.stack((along_x[:, 1], along_x[:, 0], along_x[:, 2], along_x[:, 0]), axis=-1)
    tall = np.stack((along_y[:, 0], along_y[:, 1], along_y[:, 0], along_y[:, 2]), axis=-1)
    return np.concatenate((flat, tall)).astype(np.float64)


def equal_runs(lines: NDArray[np.int8]) -> NDArray[np.int64]:
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
    if not _is_archive(path):
        return read_map(path)
    log_odds = read_map_arrays(path)
    rows, columns = log_odds.shape
    if rows * columns > MAX_PIXELS or max(rows, columns) * log_odds.cell_size > MAX_EXTENT:
        bounds = f"expected at most {MAX_PIXELS} in all and {MAX_EXTENT:g} m a side"
        raise InputError(f"{columns} x {rows} cells of {log_odds.cell_size:g} m, {bounds}", file=path, field="log_odds")
    return Raster(trinary(log_odds.values), log_odds.cell_size, log_odds.origin)


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


_TINY = 1e-9  # Pieces of wall shorter than this are rounding errors [m]


class Doorway(Section):
    """A gap in a wall: where it begins, in metres along the wall, and how wide it is [m]."""

    at: NotNegative
    width: Positive


class Recess(Section):
    """A rectangular niche in a wall: where it begins along the wall, its width and depth [m].

    A positive depth goes to the left of the wall's direction, a negative one to the right; seen from the other side a
    niche is a pilaster that stands out.
    """

    at: NotNegative
    width: Positive
    depth: Number

    @model_validator(mode="after")
    def _is_deep(self) -> Self:
        if self.depth == 0:
            raise ValueError("a depth of 0 m, expected one to the left (positive) or to the right (negative)")
        return self


class Wall(Section):
    """A polyline, closed or not, with doorways and recesses measured along it from its first point."""

    points: Annotated[tuple[Point, ...], Field(min_length=2, max_length=10_000)]
    closed: Truth = False
    doors: tuple[Doorway, ...] = ()
    recesses: tuple[Recess, ...] = ()
    material: str = PLAIN

    @property
    def corners(self) -> Array:
        """The polyline's corners [k, 2], the first repeated at the end if it is closed."""
        points = (*self.points, self.points[0]) if self.closed else self.points
        return np.asarray(points, np.float64)

    @property
    def cuts(self) -> list[Doorway | Recess]:
        """The doorways and recesses in their order along the wall."""
        cuts: list[Doorway | Recess] = [*self.doors, *self.recesses]
        return sorted(cuts, key=lambda cut: cut.at)

    @model_validator(mode="after")
    def _fits(self) -> Self:
        lengths = np.hypot(*np.diff(self.corners, axis=0).T)
        if (lengths == 0).any():
            raise ValueError("two successive points are the same, expected them apart")
        starts = np.concatenate(([0.0], np.cumsum(lengths)))
        spans = [(cut.at, cut.at + cut.width) for cut in self.cuts]
        for begin, end in spans:
            straight = int(np.searchsorted(starts, begin, "right")) - 1
            if end > starts[-1] + _TINY:
                text = f"a door or recess from {begin:g} to {end:g} m, expected within the wall's {starts[-1]:g} m"
                raise ValueError(text)
            if end > starts[straight + 1] + _TINY:
                raise ValueError(f"a door or recess at {begin:g} m goes round a corner, expected it on one straight")
        for (begin, end), (after, _) in pairwise(spans):
            if after < end:
                raise ValueError(f"the door or recess at {after:g} m overlaps the one at {begin:g} m")
        return self

    def segments(self) -> Segments:
        """The straight pieces between the doorways, the recesses included."""
        pieces, start = [np.empty((0, 4))], 0.0
        for a, b in pairwise(self.corners):
            length = float(np.hypot(*(b - a)))
            along = (b - a) / length
            left = np.array((-along[1], along[0]))
            cuts = [cut for cut in self.cuts if start <= cut.at < start + length - _TINY]
            for run in _runs(length, start, cuts):
                at, depth = np.array(run).T[:, :, None]
                points = a + at * along + depth * left
                lines = np.concatenate((points[:-1], points[1:]), axis=1)
                pieces.append(lines[np.hypot(*(points[1:] - points[:-1]).T) > _TINY])
            start += length
        return np.concatenate(pieces)

    def doorways(self) -> Iterator[Array]:
        """The ends [2, 2] of each doorway [m]."""
        start = 0.0
        for a, b in pairwise(self.corners):
            length = float(np.hypot(*(b - a)))
            for door in self.doors:
                if start <= door.at < start + length - _TINY:
                    yield a + np.array([[door.at - start], [door.at - start + door.width]]) * (b - a) / length
            start += length


def _runs(length: float, start: float, cuts: list[Doorway | Recess]) -> Iterator[list[tuple[float, float]]]:
    """The unbroken runs of a straight wall between its doorways, as points (metres along, metres to the left).

    The straight is ``length`` long and begins ``start`` along its wall, from where the cuts are measured.
    """
    run = [(0.0, 0.0)]
    for cut in cuts:
        begin, end = cut.at - start, cut.at - start + cut.width
        run.append((begin, 0.0))
        if isinstance(cut, Recess):
            run += [(begin, cut.depth), (end, cut.depth)]
        else:
            yield run
            run = []
        run.append((end, 0.0))
    yield [*run, (length, 0.0)]


class RoomDoorway(Doorway):
    """A doorway in one side of a room, measured from the side's west or south end."""

    side: Literal["north", "east", "south", "west"]


class Room(Section):
    """Four walls along the axes: the south-west corner and the size [m], with doorways in its sides."""

    corner: Point
    size: tuple[Size, Size]
    doors: tuple[RoomDoorway, ...] = ()
    material: str = PLAIN

    @model_validator(mode="after")
    def _fits(self) -> Self:
        self.segments()
        return self

    def sides(self) -> list[Wall]:
        (x, y), (w, h) = self.corner, self.size
        sides = {
            "south": ((x, y), (x + w, y)),
            "east": ((x + w, y), (x + w, y + h)),
            "north": ((x, y + h), (x + w, y + h)),
            "west": ((x, y), (x, y + h)),
        }
        walls = []
        for side, points in sides.items():
            doors = tuple(Doorway(at=door.at, width=door.width) for door in self.doors if door.side == side)
            walls.append(Wall(points=points, doors=doors))
        return walls

    def segments(self) -> Segments:
        return np.concatenate([side.segments() for side in self.sides()])


class Slippery(Section):
    """A patch of floor where wheels grip less: the south-west corner, the size [m], and the grip there."""

    corner: Point
    size: tuple[Positive, Positive]
    grip: Annotated[Number, Field(gt=0, le=2)] = 0.1


class Layout(Section):
    """The pieces of a world, and what they are made of.

    ``materials`` are tables by name, beside those of `MATERIALS` or in their place.
    """

    walls: tuple[Wall, ...] = ()
    rooms: tuple[Room, ...] = ()
    boxes: tuple[Box, ...] = ()
    pillars: tuple[Pillar, ...] = ()
    tables: tuple[Table, ...] = ()
    chairs: tuple[Chair, ...] = ()
    shelves: tuple[Shelf, ...] = ()
    plan: FloorPlan | None = None
    slippery: tuple[Slippery, ...] = ()
    materials: dict[str, Material] = Field(default_factory=dict)

    @property
    def pieces(self) -> dict[str, tuple[Wall | Room | Box | Pillar | Table | Shelf, ...]]:
        return {
            "walls": self.walls, "rooms": self.rooms, "boxes": self.boxes, "pillars": self.pillars,
            "tables": self.tables, "chairs": self.chairs, "shelves": self.shelves,
        }  # fmt: skip

    @property
    def palette(self) -> dict[str, Material]:
        """All the materials that a piece may name."""
        return {**MATERIALS, **self.materials}

    @model_validator(mode="after")
    def _materials_are_known(self) -> Self:
        known = self.palette
        for kind, pieces in self.pieces.items():
            for i, piece in enumerate(pieces):
                if piece.material not in known:
                    raise ValueError(
                        f"{kind}.{i}.material is {piece.material!r}, expected one of {', '.join(known)} "
                        "or a table [world.materials.NAME]"
                    )
        return self
