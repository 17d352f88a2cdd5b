"""Ranges in a rectangular room."""

import numpy as np
from numpy.typing import ArrayLike, NDArray


def box_ranges(
    x: ArrayLike, y: ArrayLike, angles: NDArray[np.float64], low: tuple[float, float], high: tuple[float, float]
) -> NDArray[np.float64]:
    """From places in a room, between two of its corners [m], to its walls, at these angles [rad] in its frame."""
    cos, sin = np.cos(angles), np.sin(angles)
    with np.errstate(divide="ignore"):
        across = (np.where(np.signbit(cos), low[0], high[0]) - x) / cos
        up = (np.where(np.signbit(sin), low[1], high[1]) - y) / sin
    return np.asarray(np.minimum(across, up))
