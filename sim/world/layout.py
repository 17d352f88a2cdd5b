"""Everything that stands in a world, as it is written in a scenario's TOML file."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from moteslam.robot.tables import Number, Positive, Section
from moteslam.sim.world.blocks import Box, Pillar
from moteslam.sim.world.floor_plan import FloorPlan
from moteslam.sim.world.furniture import Chair, Shelf, Table
from moteslam.sim.world.geometry import Point
from moteslam.sim.world.materials import MATERIALS, Material
from moteslam.sim.world.walls import Room, Wall


class Slippery(Section):
    """A patch of floor where wheels grip less: the south-west corner, the size [m], and the grip there."""

    corner: Point
    size: tuple[Positive, Positive]
    grip: Annotated[Number, Field(gt=0, le=2)] = 0.1


class Layout(Section):
    """The pieces of a world, and what they are made of.

    Attributes:
        walls, rooms, boxes, pillars, tables, chairs, shelves: the pieces.
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
