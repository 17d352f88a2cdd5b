"""A small picture of a map and the path through it, without Matplotlib: what a notebook shows of an estimate."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.formats.map_server import map_image
from moteslam.robot.pictures import STYLE, encode_png
from moteslam.robot.raster import Raster

LONGEST = 800
"""The longer side, at most [pixel]."""
ENLARGED = 8
"""At most this number of pixels for a side of a cell."""
MARGIN = 0.5
"""Around all that is known and the path [m]."""
SUBPIXEL = 4
"""Bits of a pixel that corners of lines are rounded to."""


def preview_png(occupancy: Raster, path: NDArray[np.float64]) -> bytes:
    """A PNG of a map in greys and a path in colour, a ring at its start and a square at its end, the largest y on top.

    What is neither known nor near the path is cut off. Of several cells in a pixel the darkest is shown, so that walls
    stay.

    Args:
        occupancy: log-odds [H, W], not turned.
        path: [n, 2 or more] x, y [m]; at least one.
    """
    import cv2

    places = (path[:, :2] - occupancy.origin[:2]) / occupancy.cell_size  # columns and rows, from the lowest
    (left, right), (bottom, top) = _window(occupancy, places)
    grey = map_image(occupancy.values[bottom:top, left:right])
    longest = max(grey.shape)
    shrink, enlarge = -(-longest // LONGEST), max(1, min(ENLARGED, LONGEST // longest))
    grey = cv2.erode(grey, np.ones((shrink, shrink), np.uint8))[shrink // 2 :: shrink, shrink // 2 :: shrink]
    grey = np.kron(grey, np.ones((enlarge, enlarge), np.uint8))
    image = np.ascontiguousarray(np.repeat(grey[..., None], 3, axis=2))

    scale = enlarge / shrink
    pixels = np.stack((places[:, 0] - left, top - places[:, 1]), axis=1) * scale - 0.5
    corners = np.rint(pixels * 2**SUBPIXEL).astype(np.int32)
    colour = tuple(bytes.fromhex(STYLE.slam.removeprefix("#")))
    cv2.polylines(image, [corners], isClosed=False, color=colour, thickness=2, lineType=cv2.LINE_AA, shift=SUBPIXEL)
    start, end = np.rint(pixels[[0, -1]]).astype(int).tolist()
    cv2.rectangle(image, [end[0] - 4, end[1] - 4], [end[0] + 4, end[1] + 4], colour, cv2.FILLED)
    cv2.circle(image, start, 7, (0, 0, 0), 2, cv2.LINE_AA)
    return encode_png(image)


def _window(occupancy: Raster, places: NDArray[np.float64]) -> tuple[tuple[int, int], tuple[int, int]]:
    """The columns and the rows, from and to, of all that is known and a path of places [n, 2]; within the map."""
    margin = int(np.ceil(MARGIN / occupancy.cell_size))
    known = occupancy.values != 0
    window = []
    for axis, size in ((0, known.shape[1]), (1, known.shape[0])):
        cells = np.append(np.flatnonzero(known.any(axis=axis)), np.clip(places[:, axis], 0, size - 1))
        window.append((max(0, int(cells.min()) - margin), min(size, int(cells.max()) + 1 + margin)))
    columns, rows = window
    return columns, rows
