"""Everything that stands in a world, as it is written in a scenario's TOML file."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot.values import NotNegative, Number, Positive, Section, Truth
from moteslam.sim.world.floor_plan import FloorPlan
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

_TINY = 1e-9
"""Pieces of wall shorter than this are rounding errors [m]."""


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
    def _is_deep(self) -> Recess:
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
    def corners(self) -> NDArray[np.float64]:
        """The polyline's corners [k, 2], the first repeated at the end if it is closed."""
        points = (*self.points, self.points[0]) if self.closed else self.points
        return np.asarray(points, np.float64)

    @property
    def cuts(self) -> list[Doorway | Recess]:
        """The doorways and recesses in their order along the wall."""
        cuts: list[Doorway | Recess] = [*self.doors, *self.recesses]
        return sorted(cuts, key=lambda cut: cut.at)

    @model_validator(mode="after")
    def _fits(self) -> Wall:
        lengths = np.hypot(*np.diff(self.corners, axis=0).T)
        if (lengths == 0).any():
            raise ValueError("two successive points are the same, expected them apart")
        starts = np.concatenate(([0.0], np.cumsum(lengths)))
        spans = [(cut.at, cut.at + cut.width) for cut in self.cuts]
        for begin, end in spans:
            straight = int(np.searchsorted(starts, begin, "right")) - 1
            if end > starts[-1] + _TINY:
                raise ValueError(f"a door or recess ends at {end:g} m, expected within the wall's {starts[-1]:g} m")
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
    def _fits(self) -> Room:
        self.segments()
        return self

    def segments(self) -> Segments:
        """The straight pieces between the doorways."""
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
            walls.append(Wall(points=points, doors=doors).segments())
        return np.concatenate(walls)


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
        """All that stands in it, by kind."""
        return {
            "walls": self.walls, "rooms": self.rooms, "boxes": self.boxes, "pillars": self.pillars,
            "tables": self.tables, "chairs": self.chairs, "shelves": self.shelves,
        }  # fmt: skip

    @property
    def palette(self) -> dict[str, Material]:
        """All the materials that a piece may name."""
        return {**MATERIALS, **self.materials}

    @model_validator(mode="after")
    def _materials_are_known(self) -> Layout:
        known = self.palette
        for kind, pieces in self.pieces.items():
            for i, piece in enumerate(pieces):
                if piece.material not in known:
                    raise ValueError(
                        f"{kind}.{i}.material is {piece.material!r}, expected one of {', '.join(known)} "
                        "or a table [world.materials.NAME]"
                    )
        return self
