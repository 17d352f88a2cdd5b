"""Parameters of the coloured map of the floor."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from moteslam.robot.values import NotNegative, Number, Section, Truth


class TextureConfig(Section):
    """The coloured map of the floor (section III.E of the paper), made of a recording that has camera images."""

    enabled: Truth = True  # Make one where there are images
    cell_size: Annotated[Number, Field(ge=0.005, le=1.0)] = 0.05  # Of the coloured map [m]
    height_limit: Number = 0.1  # Points at or above it are not floor [m]; the paper's 0.1
    # Points deeper than this are left out [m]: the error of a depth grows with its square
    max_depth: Annotated[Number, Field(gt=0, le=100)] = 8.0
    interval: NotNegative = 0.1  # Shortest time between two frames that are used [s]; 0 uses all
    largest_gap: NotNegative = 0.05  # Between the colour and the disparity image of a frame [s]
    # Take what is near the floor to lie on it, where its ray meets a flat floor, whatever its depth; the paper takes
    # the depth
    flat: Truth = False
