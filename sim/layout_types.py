"""The types that the pieces of a world share."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.section import Number

Coordinate = Annotated[Number, Field(ge=-1000, le=1000)]
Point = tuple[Coordinate, Coordinate]
Size = Annotated[Number, Field(gt=0, le=1000)]
Polygon = NDArray[np.float64]
"""float64, shape [k, 2]: corners [m]."""
Segments = NDArray[np.float64]
"""float64, shape [m, 4]: x0, y0, x1, y1 [m]."""
