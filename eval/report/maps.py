"""The map as a file: a grey picture, and the pair of files that map_server reads."""

from __future__ import annotations

from os import PathLike

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.files import write_atomically
from moteslam.robot.formats.map_server import (
    FREE,
    OCCUPIED,
    OCCUPIED_THRESHOLD,
    UNKNOWN,
    map_image,
    write_map,
)
from moteslam.robot.pictures import encode_png
from moteslam.robot.raster import Raster


def trinary(log_odds: NDArray[np.float32]) -> NDArray[np.int8]:
    """The map in map_server's three values, which one ray of log 4 (a probability of 0.2 or 0.8) decides.

    Args:
        log_odds: [H, W].

    Returns:
        int8 [H, W]: occupied above the probability of 0.65, free below its complement, else unknown.
    """
    limit = np.log(OCCUPIED_THRESHOLD / (1 - OCCUPIED_THRESHOLD))
    return np.where(log_odds > limit, OCCUPIED, np.where(log_odds < -limit, FREE, UNKNOWN)).astype(np.int8)


def write_map_png(path: str | PathLike[str], occupancy: Raster) -> None:
    """Write the map as a grey PNG, a pixel a cell.

    Raises:
        OutputError: it cannot be written.
    """
    write_atomically(path, encode_png(map_image(occupancy.values)))


def write_map_server(path: str | PathLike[str], occupancy: Raster) -> None:
    """Write ``map.pgm`` and, beside it, ``map.yaml`` as map_server and nav2 read them (trinary).

    Args:
        path: of the ``.pgm``; the ``.yaml`` has the same stem.
        occupancy: the map.

    Raises:
        OutputError: one of them cannot be written.
    """
    write_map(path, Raster(trinary(occupancy.values), occupancy.cell_size, occupancy.origin))
