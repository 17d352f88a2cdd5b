"""How uncertain the end of a motion is."""

import math
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

Lengths = TypeVar("Lengths", float, NDArray[np.float64])


def aside(distance: Lengths, heading: Lengths) -> Lengths:
    """The standard deviation of a position to the side of a motion [m], by that of the heading at its end [rad].

    An error that grows evenly with the distance [m] turns the end about the beginning by a third of its variance.
    """
    return distance * heading / math.sqrt(3)
