"""Maps as ROS's map_server keeps them: an image, and a YAML file that says where it lies and what its greys mean.

A raster has row 0 at the smallest y, an image at the largest: it is flipped here, at the file, and nowhere else. What
the YAML file and the greys mean is in ``map_server_cells``.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.files import read_bytes, write_atomically
from moteslam.robot.formats.map_server_cells import (
    FREE_GREY,
    FREE_PERCENT,
    MODES,
    OCCUPIED_GREY,
    OCCUPIED_PERCENT,
    RULES,
    UNKNOWN_GREY,
    UNKNOWN_PERCENT,
    MapFile,
    Mode,
    Rules,
    map_file_text,
    occupancies,
    pixels_of,
    read_map_file,
    saved,
    warn_of_thresholds,
)
from moteslam.robot.pictures import decode_channels, encode_png, picture_size
from moteslam.robot.raster import Raster
from moteslam.robot.values import expect_type

FREE, OCCUPIED, UNKNOWN = 0, 1, -1
"""The values of a trinary map, int8."""

OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""map_saver's own: above the one a cell is occupied, below the other free. A grey of 205 is just not free."""

MAX_IMAGE_BYTES = 256_000_000
MAX_PIXELS = 64_000_000
MAX_EXTENT = 2000.0
"""Of a map's longer side [m]."""


def read_map(path: str | PathLike[str]) -> Raster:
    """Read a map [H, W] as `FREE`, `OCCUPIED` and `UNKNOWN` cells, int8, of its ``.yaml``.

    What is between the thresholds is unknown in the mode ``scale``, too. In the mode ``raw`` they are applied as
    map_saver does: at least ``occupied_thresh`` and at most ``free_thresh``, in whole percent.

    Raises:
        InputError: a file that is missing, not YAML or no image, a key that is missing or out of bounds, an image
            elsewhere or that is too large; file and key are named.
    """
    about, pixels = _read(Path(path))
    percent = occupancies(pixels, about, between=False)
    if about.mode == "raw":
        percent = saved(percent, about.occupied, about.free)
    known = np.where(percent == OCCUPIED_PERCENT, OCCUPIED, FREE)
    return _raster(np.where(percent == UNKNOWN_PERCENT, UNKNOWN, known), about)


def read_occupancy(path: str | PathLike[str], *, rules: Rules = "nav2") -> Raster:
    """Read a map as map_server publishes it, an occupancy a cell.

    A pixel's brightness, the mean of its channels, stands for the probability of being free, with ``negate`` of being
    occupied. Above ``occupied_thresh`` a cell is occupied, below ``free_thresh`` free. In between it is unknown in the
    mode ``trinary``, where opacity is one of the channels; in the mode ``scale`` it is stretched to 0 to 100, and what
    is not opaque is unknown. In the mode ``raw`` the brightness, of 255, is the occupancy, and unknown above 100.

    Args:
        path: of the ``.yaml``; the image that it names lies beside it, or below.
        rules: ``nav2``, or ``ros1``: ROS 1's map_server, which differs in details (``map_server_cells``).

    Returns:
        int8 values [H, W]: 0 (free) to 100 (occupied), -1 unknown, as in nav_msgs/OccupancyGrid.

    Raises:
        InputError: as of `read_map`.
        ConfigError: rules of somebody else.
    """
    if rules not in RULES:
        raise ConfigError(f"{rules!r}, expected {' or '.join(RULES)}", field="rules")
    about, pixels = _read(Path(path))
    return _raster(occupancies(pixels, about, rules), about)


def write_map(path: str | PathLike[str], raster: Raster, *, mode: Mode = "trinary", negate: bool = False) -> None:
    """Write a trinary map: the image, and beside it the YAML file, as map_server and nav2 read them.

    Args:
        path: of the ``.pgm`` or ``.png``; the ``.yaml`` has the same stem.
        raster: values [H, W] of `FREE`, `OCCUPIED` or `UNKNOWN`.
        mode, negate: as of `write_occupancy`.

    Raises:
        OutputError, InputError, ConfigError: as of `write_occupancy`.
    """
    known = np.where(raster.values == OCCUPIED, OCCUPIED_PERCENT, FREE_PERCENT)
    percent = np.where(raster.values == UNKNOWN, UNKNOWN_PERCENT, known).astype(np.int8)
    write_occupancy(path, Raster(percent, raster.cell_size, raster.origin), mode=mode, negate=negate)


def write_occupancy(
    path: str | PathLike[str],
    raster: Raster,
    *,
    mode: Mode = "raw",
    negate: bool = False,
    thresholds: tuple[float, float] = (OCCUPIED_THRESHOLD, FREE_THRESHOLD),
) -> None:
    """Write a map of occupancies as map_saver does: the image, and beside it the YAML file.

    In the mode ``raw`` they read back the same. In the mode ``scale`` a grey is the occupancy, which whoever reads it
    scales between the thresholds: with those of 1 and 0 it reads back the same. In the mode ``trinary`` the thresholds
    decide.

    Args:
        path: of the ``.pgm`` or ``.png``; the ``.yaml`` has the same stem.
        raster: whole values [H, W] of -1 (unknown) or 0 to 100, see `occupancy_of` for log-odds.
        mode: ``trinary``, ``scale`` or ``raw``.
        negate: white is occupied; not in the mode ``raw``, which nav2 reads without and ROS 1 with it.
        thresholds: at least the first is occupied, at most the second free; 0 to 1.

    Raises:
        ConfigError: a mode that is none, or thresholds the wrong way round.
        InputError: other values, or ``negate`` in the mode ``raw``.
        OutputError: another ending, unknown cells of the mode ``scale`` in a ``.pgm``, which has no transparency, or
            a file that cannot be written.
    """
    expect_type(raster, Raster, "raster")
    path, (occupied, free) = Path(path), thresholds
    if mode not in MODES:
        raise ConfigError(f"{mode!r}, expected {', '.join(MODES)}", field="mode")
    if not 0 <= free <= occupied <= 1:
        raise ConfigError(f"{thresholds!r}, expected occupied and free, the larger first, 0 to 1", field="thresholds")
    values = raster.values
    if values.ndim != 2 or values.dtype.kind not in "iu" or not ((values >= -1) & (values <= 100)).all():
        raise InputError(
            f"{values.dtype}{list(values.shape)}, expected whole values of -1 to 100 [H, W]", field="raster"
        )
    if path.suffix not in (".pgm", ".png"):
        raise OutputError("expected a name that ends in .pgm or .png", file=path)
    image = pixels_of(values.astype(np.int8), mode, occupied=occupied, free=free, negate=negate)[::-1]
    if path.suffix == ".png":
        write_atomically(path, encode_png(image))
    elif image.ndim == 3:
        raise OutputError("has no transparency for the unknown cells of the mode scale, expected a .png", file=path)
    else:
        rows, columns = image.shape
        write_atomically(path, f"P5\n{columns} {rows}\n255\n".encode() + image.tobytes())
    if mode == "trinary":  # the greys are map_saver's own, whatever decided
        occupied, free = OCCUPIED_THRESHOLD, FREE_THRESHOLD
    about = {"negate": int(negate), "occupied_thresh": float(occupied), "free_thresh": float(free)}
    _write_yaml(path, raster, {"mode": mode}, about)


def occupancy_of(log_odds: Raster) -> Raster:
    """A map of log-odds as occupancies: the probability in whole percent, -1 where the log-odds are 0.

    Args:
        log_odds: float values [H, W], above 0 occupied.

    Returns:
        int8 values [H, W].

    Raises:
        InputError: values that are no floats [H, W].
    """
    expect_type(log_odds, Raster, "log_odds")
    values = log_odds.values
    if values.ndim != 2 or values.dtype.kind != "f":
        raise InputError(f"{values.dtype}{list(values.shape)}, expected floats [H, W]", field="log_odds")
    percent = np.rint(50 * (1 + np.tanh(values / 2)))  # 100 / (1 + exp(-l)), which cannot overflow
    known = np.isfinite(values) & (values != 0)
    return Raster(np.where(known, percent, UNKNOWN_PERCENT).astype(np.int8), log_odds.cell_size, log_odds.origin)


def write_picture(path: str | PathLike[str], raster: Raster, about: Mapping[str, Any] | None = None) -> None:
    """Write a coloured raster as PNG, a pixel a cell, and beside it the YAML file that says where it lies.

    Args:
        path: of the ``.png``; the ``.yaml`` has the same stem.
        raster: values [H, W, 3] red, green, blue or [H, W, 4] with opacity, uint8.
        about: more keys for the YAML file.

    Raises:
        OutputError: one of them cannot be written.
    """
    write_atomically(path, encode_png(raster.values[::-1]))
    _write_yaml(Path(path), raster, {}, about or {})


def trinary(log_odds: NDArray[np.float32]) -> NDArray[np.int8]:
    """The map in map_server's three values, which one ray of log 4 (a probability of 0.2 or 0.8) decides.

    Args:
        log_odds: [H, W].

    Returns:
        int8 [H, W]: occupied above the probability of 0.65, free below its complement, else unknown.
    """
    limit = np.log(OCCUPIED_THRESHOLD / (1 - OCCUPIED_THRESHOLD))
    return np.where(log_odds > limit, OCCUPIED, np.where(log_odds < -limit, FREE, UNKNOWN)).astype(np.int8)


def map_image(log_odds: NDArray[np.float32]) -> NDArray[np.uint8]:
    """The map in greys: white where free, black where occupied, 205 where nothing is known, and in between.

    Args:
        log_odds: [H, W], row 0 the smallest y.

    Returns:
        [H, W] uint8, row 0 the largest y.
    """
    belief = np.tanh(np.asarray(log_odds, np.float64)[::-1] / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    towards_free, towards_occupied = UNKNOWN_GREY - FREE_GREY, OCCUPIED_GREY - UNKNOWN_GREY
    grey = UNKNOWN_GREY + np.where(belief < 0, towards_free * belief, towards_occupied * belief)
    return np.asarray(np.rint(grey), np.uint8)


def _read(path: Path) -> tuple[MapFile, NDArray[np.uint16]]:
    """The YAML file, and the pixels [rows, columns, channels] of its image, the largest y first."""
    about = read_map_file(path)
    try:
        content = read_bytes(about.image, "a pgm or png image", limit=MAX_IMAGE_BYTES)
    except InputError as error:
        raise InputError(f"{about.image.name}: {error.problem}", file=path, field="image") from error
    columns, rows = picture_size(content) or (0, 0)
    if columns * rows > MAX_PIXELS:
        raise InputError(f"{columns} x {rows} pixels, expected at most {MAX_PIXELS} in all", file=about.image)
    if max(columns, rows) * about.resolution > MAX_EXTENT:
        raise InputError(
            f"{columns} x {rows} cells of {about.resolution:g} m, expected at most {MAX_EXTENT:g} m a side",
            file=path,
            field="resolution",
        )
    pixels = decode_channels(content) if columns * rows else None
    if pixels is None:
        raise InputError("not readable as an image, expected a complete pgm or png map", file=about.image)
    warn_of_thresholds(path, about, pixels)
    return about, pixels


def _write_yaml(image: Path, raster: Raster, before: dict[str, Any], after: Mapping[str, Any]) -> None:
    """Write the YAML file beside an image, under its name."""
    place = {"resolution": float(raster.cell_size), "origin": [float(value) for value in raster.origin]}
    write_atomically(image.with_suffix(".yaml"), map_file_text(image, place, before, dict(after)))


def _raster(values: NDArray[Any], about: MapFile) -> Raster:
    """Values [rows, columns] of an image as a raster that nobody writes to, the smallest y first."""
    values = np.ascontiguousarray(values[::-1], np.int8)
    values.setflags(write=False)
    return Raster(values, about.resolution, about.origin)
