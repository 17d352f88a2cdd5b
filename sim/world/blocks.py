"""Solid pieces from floor to ceiling: boxes and pillars."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field

from moteslam.robot.tables import Number, Section, Whole
from moteslam.sim.world.geometry import Point, Polygon, Size, rectangle
from moteslam.sim.world.materials import PLAIN


class Box(Section):
    """A solid rectangle: its centre and size [m], turned by ``angle`` [rad]."""

    centre: Point
    size: tuple[Size, Size]
    angle: Number = 0.0
    material: str = PLAIN

    def polygon(self) -> Polygon:
        """The corners [4, 2], counterclockwise [m]."""
        return rectangle(self.centre, self.size, self.angle)


class Pillar(Section):
    """A solid regular polygon in place of a round pillar: its centre and radius [m] and number of sides."""

    centre: Point
    radius: Size
    sides: Annotated[Whole, Field(ge=3, le=256)] = 12
    material: str = PLAIN

    def polygon(self) -> Polygon:
        """The corners [sides, 2], counterclockwise [m]."""
        angle = 2 * np.pi * np.arange(self.sides) / self.sides
        return self.centre + self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)
