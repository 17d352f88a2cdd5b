"""The pieces a scenario's world is built of, as they stand in its TOML file, and the segments they become."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot.section import NotNegative, Number, Positive, Section, Truth, Whole
from moteslam.sim.floorplan import FloorPlan
from moteslam.sim.furniture import Chair, Shelf, Table, rectangle
from moteslam.sim.layout_types import Point, Segments, Size
from moteslam.sim.materials import MATERIALS, PLAIN, Material
from moteslam.sim.moving import Slippery

__all__ = ["Box", "Door", "Layout", "Pillar", "Point", "Recess", "Room", "RoomDoor", "Segments", "Size", "Wall"]

_TINY = 1e-9
"""Shorter than any piece of wall that is meant [m]."""


class Door(Section):
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
    """A polyline, closed or not, with doors (gaps) and recesses measured along it from its first point."""

    points: Annotated[tuple[Point, ...], Field(min_length=2, max_length=10_000)]
    closed: Truth = False
    doors: tuple[Door, ...] = ()
    recesses: tuple[Recess, ...] = ()
    material: str = PLAIN

    @property
    def corners(self) -> NDArray[np.float64]:
        """The polyline's corners [k, 2], the first repeated at the end if it is closed."""
        points = (*self.points, self.points[0]) if self.closed else self.points
        return np.asarray(points, np.float64)

    @property
    def cuts(self) -> list[Door | Recess]:
        """The doors and recesses, as they come along the wall."""
        cuts: list[Door | Recess] = [*self.doors, *self.recesses]
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
        """The straight pieces left of the doors, with the recesses worked in."""
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


def _runs(length: float, start: float, cuts: list[Door | Recess]) -> Iterator[list[tuple[float, float]]]:
    """The unbroken runs of a straight wall between its doors, as points (metres along, metres to the left).

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


class RoomDoor(Door):
    """A door in one side of a room, measured from the side's west or south end."""

    side: Literal["north", "east", "south", "west"]


class Room(Section):
    """Four walls along the axes: the south-west corner and the size [m], with doors in its sides."""

    corner: Point
    size: tuple[Size, Size]
    doors: tuple[RoomDoor, ...] = ()
    material: str = PLAIN

    @model_validator(mode="after")
    def _fits(self) -> Room:
        self.segments()
        return self

    def segments(self) -> Segments:
        """The walls left of the doors."""
        (x, y), (w, h) = self.corner, self.size
        sides = {
            "south": ((x, y), (x + w, y)),
            "east": ((x + w, y), (x + w, y + h)),
            "north": ((x, y + h), (x + w, y + h)),
            "west": ((x, y), (x, y + h)),
        }
        walls = []
        for side, points in sides.items():
            doors = tuple(Door(at=door.at, width=door.width) for door in self.doors if door.side == side)
            walls.append(Wall(points=points, doors=doors).segments())
        return np.concatenate(walls)


class Box(Section):
    """A solid rectangle: its centre and size [m], turned by ``angle`` [rad]."""

    centre: Point
    size: tuple[Size, Size]
    angle: Number = 0.0
    material: str = PLAIN

    def polygon(self) -> NDArray[np.float64]:
        """The corners [4, 2], counterclockwise [m]."""
        return rectangle(self.centre, self.size, self.angle)


class Pillar(Section):
    """A solid regular polygon in place of a round pillar: its centre and radius [m] and number of sides."""

    centre: Point
    radius: Size
    sides: Annotated[Whole, Field(ge=3, le=256)] = 12
    material: str = PLAIN

    def polygon(self) -> NDArray[np.float64]:
        """The corners [sides, 2], counterclockwise [m]."""
        angle = 2 * np.pi * np.arange(self.sides) / self.sides
        return self.centre + self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)


class Layout(Section):
    """Everything that stands in a world, and what it is made of.

    Attributes:
        walls, rooms, boxes, pillars, tables, chairs, shelves: what stands there.
        plan: a floor plan whose walls stand there too.
        slippery: patches of floor where wheels grip less.
        materials: tables of materials by name, beside those of `MATERIALS` or in their place.
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
    def palette(self) -> dict[str, Material]:
        """All the materials that a piece may name."""
        return {**MATERIALS, **self.materials}

    @model_validator(mode="after")
    def _materials_are_known(self) -> Layout:
        known = self.palette
        for kind in ("walls", "rooms", "boxes", "pillars", "tables", "chairs", "shelves"):
            for i, piece in enumerate(getattr(self, kind)):
                if piece.material not in known:
                    raise ValueError(
                        f"{kind}.{i}.material is {piece.material!r}, expected one of {', '.join(known)} "
                        "or a table [world.materials.NAME]"
                    )
        return self
