"""The types that the pieces of a world share, and the shapes they are made of."""

from __future__ import annotations

import math
from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.tables import Number

Coordinate = Annotated[Number, Field(ge=-1000, le=1000)]
Point = tuple[Coordinate, Coordinate]
Size = Annotated[Number, Field(gt=0, le=1000)]
Polygon = NDArray[np.float64]
"""float64, shape [k, 2]: corners [m]."""
Segments = NDArray[np.float64]
"""float64, shape [m, 4]: x0, y0, x1, y1 [m]."""


def rectangle(centre: Point, size: tuple[float, float], angle: float) -> Polygon:
    """The corners [4, 2] of a rectangle turned by ``angle`` [rad], counterclockwise [m]."""
    w, h = size
    corners = np.array([(-w, -h), (w, -h), (w, h), (-w, h)]) / 2
    cos, sin = math.cos(angle), math.sin(angle)
    return np.asarray(centre + corners @ np.array([(cos, sin), (-sin, cos)]))


def outline(polygon: Polygon) -> Segments:
    """The sides [k, 4] of a polygon [k, 2]."""
    return np.concatenate((polygon, np.roll(polygon, -1, axis=0)), axis=1)
