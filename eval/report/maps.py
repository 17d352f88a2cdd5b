"""The map as a file: a grey picture, and the pair of files that map_server reads."""

from __future__ import annotations

from os import PathLike

from moteslam.robot.files import write_atomically
from moteslam.robot.formats.map_arrays import MapArrays
from moteslam.robot.formats.map_server import map_image, trinary, write_map
from moteslam.robot.pictures import encode_png
from moteslam.robot.raster import Raster


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


def log_odds_arrays(occupancy: Raster) -> MapArrays:
    """The map as it goes into ``map.npz``: log-odds as they are."""
    return MapArrays(
        kind="log_odds",
        arrays={"log_odds": occupancy.values},
        cell_size=occupancy.cell_size,
        origin=occupancy.origin,
    )
