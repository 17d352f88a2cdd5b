"""The map as a file: a grey picture, and the pair of files that map_server reads.

A grid has row 0 at the smallest y, an image at the largest: here, at the file, it is flipped.
"""

from __future__ import annotations

from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.files import write_atomically
from moteslam.slam.mapping.occupancy import OccupancyMap

FREE, UNKNOWN, OCCUPIED = 254, 205, 0
"""The greys of map_server's trinary maps."""

OCCUPIED_ABOVE = 0.65
"""A cell is occupied above this probability and free below its complement; one ray of log 4 (0.2) decides."""


def map_image(log_odds: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The map in greys: white where free, black where occupied, 205 where nothing is known, and in between.

    Args:
        log_odds: [H, W], row 0 the smallest y.

    Returns:
        [H, W] uint8, row 0 the largest y.
    """
    belief = np.tanh(np.asarray(log_odds, np.float64)[::-1] / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    grey = UNKNOWN + np.where(belief < 0, (UNKNOWN - FREE) * belief, (OCCUPIED - UNKNOWN) * belief)
    return np.asarray(np.rint(grey), np.uint8)


def trinary_image(log_odds: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The map in map_server's three greys: 254 free, 0 occupied, 205 unknown.

    Args:
        log_odds: [H, W], row 0 the smallest y.

    Returns:
        [H, W] uint8, row 0 the largest y.
    """
    log_odds = np.asarray(log_odds)[::-1]
    limit = np.log(OCCUPIED_ABOVE / (1 - OCCUPIED_ABOVE))
    return np.where(log_odds > limit, OCCUPIED, np.where(log_odds < -limit, FREE, UNKNOWN)).astype(np.uint8)


def write_map_png(path: str | PathLike[str], occupancy: OccupancyMap) -> None:
    """Write the map as a grey PNG, a pixel a cell.

    Raises:
        OutputError: it cannot be written.
    """
    import cv2

    write_atomically(path, cv2.imencode(".png", map_image(occupancy.log_odds))[1].tobytes())


def write_map_server(path: str | PathLike[str], occupancy: OccupancyMap) -> None:
    """Write ``map.pgm`` and, beside it, ``map.yaml`` as map_server and nav2 read them (trinary).

    Args:
        path: of the ``.pgm``; the ``.yaml`` has the same stem.
        occupancy: the map.

    Raises:
        OutputError: one of them cannot be written.
    """
    path = Path(path)
    image = trinary_image(occupancy.log_odds)
    height, width = image.shape
    write_atomically(path, f"P5\n{width} {height}\n255\n".encode() + image.tobytes())
    x, y = (float(value) for value in occupancy.origin)
    write_atomically(
        path.with_suffix(".yaml"),
        f"image: {path.name}\n"
        "mode: trinary\n"
        f"resolution: {float(occupancy.cell_size)!r}\n"
        f"origin: [{x!r}, {y!r}, 0.0]\n"
        "negate: 0\n"
        "occupied_thresh: 0.65\n"
        "free_thresh: 0.196\n",
    )
