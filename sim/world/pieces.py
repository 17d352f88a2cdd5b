"""The pieces of a world: what they are made of, their shapes, blocks and furniture."""

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from moteslam.robot.values import Angle, Number, Positive, Section, Share, Whole


def _x_y(value: object) -> object:
    if isinstance(value, list | tuple) and len(value) != 2:
        raise ValueError(f"{len(value)} numbers, expected x, y")
    return value


Coordinate = Annotated[Number, Field(ge=-1000, le=1000)]
Point = Annotated[tuple[Coordinate, Coordinate], BeforeValidator(_x_y)]
Size = Annotated[Number, Field(gt=0, le=1000)]
Polygon = NDArray[np.float64]  # float64, shape [k, 2]: corners [m]
Segments = NDArray[np.float64]  # float64, shape [m, 4]: x0, y0, x1, y1 [m]


def rectangle(centre: Point, size: tuple[float, float], angle: float) -> Polygon:
    """The corners [4, 2] of a rectangle turned by ``angle`` [rad], counterclockwise [m]."""
    w, h = size
    corners = np.array([(-w, -h), (w, -h), (w, h), (-w, h)]) / 2
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray(centre + corners @ np.array([(cos, sin), (-sin, cos)]))


def outline(polygon: Polygon) -> Segments:
    """The sides [k, 4] of a polygon [k, 2]."""
    return np.concatenate((polygon, np.roll(polygon, -1, axis=0)), axis=1)


PLAIN = "plain"


class Material(Section):
    """A surface as a lidar at 905 nm sees it. A material without any key behaves like white paper.

    A beam that comes in at an angle to the surface's normal passes with a probability that falls from ``passes``
    to ``passes_square`` square on, as exp(-(angle / lobe)^2) rises: a pane's own reflection is a mirror's, so it comes
    back to the sensor only within a few degrees of square on (Foster, Sun, Park and Kuipers 2013 measured so).
    """

    passes: Share = 0.0  # share of the beams that go through, far from square on
    passes_square: Share = 0.0  # the same, square on
    # share of the others that go on as from a mirror; within lobe [rad] of square on the mirror shows the sensor
    # itself, and the beam counts as seen
    mirrors: Share = 0.0
    lobe: Annotated[Number, Field(gt=0, le=1.6)] = 0.1
    # where the last echo of a square surface comes from [m]; it shrinks with the root of the cosine of the angle, as
    # the power that comes back falls with the square of the range (Lambert's law)
    reach: Positive | None = None
    dropout: Share = 0.0  # share of the beams seen that give no usable reading


MATERIALS = {
    PLAIN: Material(),
    # a window reflects 8 % at its two faces, square on straight back into the sensor
    "glass": Material(passes=0.92, passes_square=0.2, lobe=0.1),
    # the 30 m of the data sheet are those of white paper (90 % diffuse); 5 % give 30 m * sqrt(0.05 / 0.9)
    "black": Material(reach=7.0, dropout=0.05),
    # polished metal
    "shiny": Material(mirrors=0.7, lobe=0.15, dropout=0.1),
}
"""The materials that need no table of their own."""


class Block(Section):
    """Something that stands in the world."""

    def polygon(self) -> Polygon:
        """What it takes on the floor, counterclockwise [k, 2] [m]."""
        raise NotImplementedError

    def solids(self) -> list[Polygon]:
        return [self.polygon()]

    def segments(self) -> Segments:
        """What a lidar sees of it."""
        return np.concatenate([outline(solid) for solid in self.solids()])


class Rectangle(Block):
    """A rectangle: its centre and size [m], turned by ``angle`` [rad]."""

    centre: Point
    size: tuple[Size, Size]
    angle: Angle = 0.0

    def polygon(self) -> Polygon:
        """The corners [4, 2]."""
        return rectangle(self.centre, self.size, self.angle)


class Box(Rectangle):
    material: str = PLAIN


class Pillar(Block):
    """A solid regular polygon in place of a round pillar: its centre and radius [m] and number of sides."""

    centre: Point
    radius: Size
    sides: Annotated[Whole, Field(ge=3, le=256)] = 12
    material: str = PLAIN

    def polygon(self) -> Polygon:
        """The corners [sides, 2]."""
        angle = 2 * np.pi * np.arange(self.sides) / self.sides
        return self.centre + self.radius * np.stack((np.cos(angle), np.sin(angle)), axis=-1)


Leg = Annotated[Number, Field(gt=0.005, le=0.5)]


class Table(Rectangle):
    """Four square legs under the corners of a board that the lidar looks under."""

    size: tuple[Size, Size] = (1.6, 0.8)
    leg: Leg = 0.06
    material: str = PLAIN

    def solids(self) -> list[Polygon]:
        wide, deep = (max(side - self.leg, 0.0) for side in self.size)
        corners = rectangle(self.centre, (wide, deep), self.angle)
        return [rectangle((x, y), (self.leg, self.leg), self.angle) for x, y in corners]


class Chair(Table):
    size: tuple[Size, Size] = (0.45, 0.45)
    leg: Leg = 0.03


class Shelf(Rectangle):
    """An open shelf: its back and sides are boards, uprights divide it; its front is open to the left of ``angle``.

    ``size`` is along the back and deep [m], ``angle`` of the back [rad], ``bay`` the largest distance between uprights.
    """

    size: tuple[Size, Size] = (2.0, 0.4)
    bay: Annotated[Number, Field(ge=0.05, le=1000)] = 1.0
    material: str = PLAIN

    def solids(self) -> list[Polygon]:
        """None: beams see into it."""
        return []

    def segments(self) -> Segments:
        a, b, c, d = self.polygon()
        count = max(1, math.ceil(self.size[0] / self.bay - 1e-9))
        share = np.linspace(0.0, 1.0, count + 1)[:, None]
        uprights = np.concatenate((a + share * (b - a), d + share * (c - d)), axis=1)
        return np.concatenate((np.concatenate((a, b))[None], uprights))
