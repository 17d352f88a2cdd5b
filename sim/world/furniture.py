"""Furniture as a lidar at knee height sees it: legs, and boards."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from pydantic import Field

from moteslam.robot.tables import Number, Section
from moteslam.sim.world.geometry import Point, Polygon, Segments, Size, rectangle
from moteslam.sim.world.materials import PLAIN

Leg = Annotated[Number, Field(gt=0.005, le=0.5)]


class Table(Section):
    """Four square legs under the corners of a board that the lidar looks under: centre, size [m], angle [rad]."""

    centre: Point
    size: tuple[Size, Size] = (1.6, 0.8)
    angle: Number = 0.0
    leg: Leg = 0.06
    material: str = PLAIN

    def board(self) -> Polygon:
        """The corners [4, 2] of the board, counterclockwise [m]."""
        return rectangle(self.centre, self.size, self.angle)

    def polygons(self) -> list[Polygon]:
        """The legs."""
        inset = (max(self.size[0] - self.leg, 0.0), max(self.size[1] - self.leg, 0.0))
        return [
            rectangle((x, y), (self.leg, self.leg), self.angle) for x, y in rectangle(self.centre, inset, self.angle)
        ]


class Chair(Table):
    """A small table."""

    size: tuple[Size, Size] = (0.45, 0.45)
    leg: Leg = 0.03


class Shelf(Section):
    """An open shelf: its back and sides are boards, uprights divide it; its front is open to the left of ``angle``.

    Attributes:
        centre: of its rectangle [m].
        size: along the back, and deep [m].
        angle: of the back [rad].
        bay: largest distance between two uprights [m].
    """

    centre: Point
    size: tuple[Size, Size] = (2.0, 0.4)
    angle: Number = 0.0
    bay: Annotated[Number, Field(ge=0.05, le=1000)] = 1.0
    material: str = PLAIN

    def polygon(self) -> Polygon:
        """The rectangle [4, 2] [m] that nothing else may stand in."""
        return rectangle(self.centre, self.size, self.angle)

    def segments(self) -> Segments:
        """The back and the uprights."""
        a, b, c, d = self.polygon()
        count = max(1, math.ceil(self.size[0] / self.bay - 1e-9))
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        uprights = np.concatenate((a + share * (b - a), d + share * (c - d)), axis=1)
        return np.concatenate((np.concatenate((a, b))[None], uprights))
