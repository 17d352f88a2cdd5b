"""Maps as ROS's map_server keeps them: an image, and a YAML file that says where it lies and what its greys mean.

A raster has row 0 at the smallest y, an image at the largest: it is flipped here, at the file, and nowhere else.

Occupancies are -1 (unknown) or 0 to 100 %, as in nav_msgs/OccupancyGrid. Source: how nav2's map_server (Foxy to Jazzy)
reads maps, in the modes trinary, scale and raw, and how map_saver writes them, in the mode trinary.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path, PureWindowsPath
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamWarning, OutputError
from moteslam.robot.files import read_bytes, read_yaml, write_atomically
from moteslam.robot.raster import FULL, Raster, decode_channels, encode_png, picture_size
from moteslam.robot.values import expect_type

FREE, OCCUPIED, UNKNOWN = 0, 1, -1
"""The values of a trinary map, int8."""
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""map_saver's own: above the one a cell is occupied, below the other free. A grey of 205 is just not free."""
UNKNOWN_PERCENT, FREE_PERCENT, OCCUPIED_PERCENT = -1, 0, 100
FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205
"""The greys that map_saver writes for them in the mode trinary."""

MAX_IMAGE_BYTES = 256_000_000
MAX_YAML_BYTES = 100_000
MAX_PIXELS = 64_000_000
MAX_EXTENT = 2000.0
"""Of a map's longer side [m]."""
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""
_BAND = 1 << 20
"""Pixels that are worked on at once."""

Percent = NDArray[np.int8]
MODES = ("trinary", "scale", "raw")


@dataclass(frozen=True)
class MapFile:
    """What the YAML file says."""

    image: Path
    resolution: float  # side of a cell [m]
    origin: tuple[float, float, float]  # x, y [m] and yaw [rad] of the lower left corner of the image
    mode: str
    negate: bool  # white is occupied
    occupied: float
    free: float


def read_map(path: str | PathLike[str]) -> Raster:
    """Read a map [H, W] as `FREE`, `OCCUPIED` and `UNKNOWN` cells, int8, of its ``.yaml``.

    What is between the thresholds is unknown in the mode ``scale``, too; the mode ``raw`` is decided as by map_saver.

    Raises:
        InputError: a file that is missing, not YAML or no image, a key that is missing or out of bounds, an image
            elsewhere or that is too large; file and key are named.
    """
    about, pixels = _read(Path(path))
    percent = _occupancies(pixels, about, between=False)
    if about.mode == "raw":
        beyond = np.where(percent >= round(100 * about.occupied), OCCUPIED_PERCENT, UNKNOWN_PERCENT)
        known = np.where(percent <= round(100 * about.free), FREE_PERCENT, beyond)
        percent = np.where(percent >= 0, known, UNKNOWN_PERCENT)
    known = np.where(percent == OCCUPIED_PERCENT, OCCUPIED, FREE)
    return _raster(np.where(percent == UNKNOWN_PERCENT, UNKNOWN, known), about)


def read_occupancy(path: str | PathLike[str]) -> Raster:
    """Read a map as map_server publishes it: values [H, W] int8 of 0 (free) to 100 (occupied), -1 unknown.

    Raises as `read_map`.
    """
    about, pixels = _read(Path(path))
    return _raster(_occupancies(pixels, about), about)


def write_map(path: str | PathLike[str], raster: Raster) -> None:
    """Write a map as map_saver does: the image, and beside it the YAML file.

    Raises:
        InputError: other values [H, W] than `FREE`, `OCCUPIED` and `UNKNOWN`.
        OutputError: another ending, or a file that cannot be written.
    """
    expect_type(raster, Raster, "raster")
    path, values = Path(path), raster.values
    greys = {UNKNOWN: UNKNOWN_GREY, FREE: FREE_GREY, OCCUPIED: OCCUPIED_GREY}
    if values.ndim != 2 or not np.isin(values, list(greys)).all():
        problem = f"{values.dtype}{list(values.shape)}, expected free, occupied and unknown cells [H, W]"
        raise InputError(problem, field="raster")
    if path.suffix not in (".pgm", ".png"):
        raise OutputError("expected a name that ends in .pgm or .png", file=path)
    image = np.select([values[::-1] == value for value in greys], list(greys.values())).astype(np.uint8)
    rows, columns = image.shape
    is_png = path.suffix == ".png"
    content = encode_png(image) if is_png else f"P5\n{columns} {rows}\n255\n".encode() + image.tobytes()
    write_atomically(path, content)
    about = {"negate": 0, "occupied_thresh": OCCUPIED_THRESHOLD, "free_thresh": FREE_THRESHOLD}
    _write_yaml(path, raster, {"mode": "trinary"}, about)


def write_picture(path: str | PathLike[str], raster: Raster, about: Mapping[str, Any] | None = None) -> None:
    """Write a coloured raster as PNG, a pixel a cell, and beside it the YAML file that says where it lies.

    Its values are [H, W, 3] red, green, blue or [H, W, 4] with opacity, uint8; ``about`` are more keys for the YAML.
    """
    write_atomically(path, encode_png(raster.values[::-1]))
    _write_yaml(Path(path), raster, {}, about or {})


def trinary(log_odds: NDArray[np.float32]) -> NDArray[np.int8]:
    """Log-odds [H, W] in map_server's three values, which one ray of log 4 (a probability of 0.8) decides."""
    limit = np.log(OCCUPIED_THRESHOLD / (1 - OCCUPIED_THRESHOLD))
    return np.where(log_odds > limit, OCCUPIED, np.where(log_odds < -limit, FREE, UNKNOWN)).astype(np.int8)


def map_image(log_odds: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Log-odds [H, W] in greys, row 0 the largest y: white where free, black where occupied, 205 where unknown."""
    belief = np.tanh(np.asarray(log_odds, np.float64)[::-1] / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    towards_free, towards_occupied = UNKNOWN_GREY - FREE_GREY, OCCUPIED_GREY - UNKNOWN_GREY
    grey = UNKNOWN_GREY + np.where(belief < 0, towards_free * belief, towards_occupied * belief)
    return np.asarray(np.rint(grey), np.uint8)


def _read(path: Path) -> tuple[MapFile, NDArray[np.uint16]]:
    """The YAML file, and the pixels [rows, columns, channels] of its image, the largest y first."""
    about = _read_yaml(path)
    try:
        content = read_bytes(about.image, "a pgm or png image", limit=MAX_IMAGE_BYTES)
    except InputError as error:
        raise InputError(f"{about.image.name}: {error.problem}", file=path, field="image") from error
    columns, rows = picture_size(content) or (0, 0)
    if columns * rows > MAX_PIXELS:
        raise InputError(f"{columns} x {rows} pixels, expected at most {MAX_PIXELS} in all", file=about.image)
    if max(columns, rows) * about.resolution > MAX_EXTENT:
        problem = f"{columns} x {rows} cells of {about.resolution:g} m, expected at most {MAX_EXTENT:g} m a side"
        raise InputError(problem, file=path, field="resolution")
    pixels = decode_channels(content) if columns * rows else None
    if pixels is None:
        problem = "not readable as an image, expected a whole png map, or a pgm of 255 or 65535 greys"
        raise InputError(problem, file=about.image)
    _warn_of_thresholds(path, about, pixels)
    return about, pixels


def _read_yaml(path: Path) -> MapFile:
    about = read_yaml(path, "a map_server .yaml file", limit=MAX_YAML_BYTES)
    if not isinstance(about, dict):
        raise InputError("not a table, expected image, resolution and origin", file=path)

    def number(key: str, value: object, low: float, high: float) -> float:
        try:  # what is text to YAML 1.1 is a number to the programs that write it, as 5e-2
            found = float("nan") if isinstance(value, bool) else float(value)  # type: ignore[arg-type]
        except (TypeError, ValueError, OverflowError):
            found = float("nan")
        if not low <= found <= high:
            expected = "three numbers: x, y [m] and yaw [rad]" if key == "origin" else f"one from {low:g} to {high:g}"
            raise InputError(f"{about[key]!r}, expected {expected}", file=path, field=key)
        return found

    for key in ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh"):
        if key not in about:
            raise InputError("missing, expected in every map_server file", file=path, field=key)
    occupied, free = (number(key, about[key], 0, 1) for key in ("occupied_thresh", "free_thresh"))
    if free > occupied:
        raise InputError(f"{free:g}, expected at most occupied_thresh, {occupied:g}", file=path, field="free_thresh")
    if (mode := about.get("mode", MODES[0])) not in MODES:
        raise InputError(f"{mode!r}, expected {', '.join(MODES)}", file=path, field="mode")
    if not isinstance(negate := about["negate"], int):
        raise InputError(f"{negate!r}, expected 0 or 1", file=path, field="negate")
    place = about["origin"] if isinstance(about["origin"], list) and len(about["origin"]) == 3 else [None]
    x, y, yaw = [number("origin", value, -MAX_PLACE, MAX_PLACE) for value in place]
    resolution = number("resolution", about["resolution"], 1e-4, 100)
    return MapFile(_image(about["image"], path), resolution, (x, y, yaw), mode, bool(negate), occupied, free)


def _image(name: object, path: Path) -> Path:
    """The image's path, in the YAML file's folder or below; one of another computer is looked for beside it."""
    if not isinstance(name, str) or not name:
        raise InputError(f"{name!r}, expected the name of a pgm or png image", file=path, field="image")
    image = path.parent / name
    try:
        inside = image.resolve().is_relative_to(path.parent.resolve())
        there = PureWindowsPath(name)  # knows both slashes
        beside = path.parent / there.name
        if there.root and not (inside and image.is_file()) and beside.is_file() and not beside.is_symlink():
            text = f"{path}: image: {name[:200]!r} is not in its folder, {beside.name!r} beside it is taken"
            warnings.warn(MoteslamWarning(text), stacklevel=2)
            return beside
    except (OSError, ValueError, RuntimeError) as error:  # a null byte in the name, links in a circle
        raise InputError(f"{name!r}, expected a pgm or png image", file=path, field="image") from error
    if not inside:
        expected = "expected an image in the folder of this file, or below"
        raise InputError(f"{name!r} lies elsewhere, {expected}", file=path, field="image")
    return image


def _occupancies(pixels: NDArray[np.uint16], about: MapFile, *, between: bool = True) -> Percent:
    """The occupancies [H, W] of pixels [H, W, C] of 65535; ``between`` the thresholds the mode scale may say more."""
    flat, found = pixels.reshape(-1, pixels.shape[2]), np.empty(pixels.shape[0] * pixels.shape[1], np.int8)
    for start in range(0, len(flat), _BAND):
        found[start : start + _BAND] = _of(flat[start : start + _BAND], about, between)
    return found.reshape(pixels.shape[:2])


def _of(pixels: NDArray[np.uint16], about: MapFile, between: bool) -> Percent:
    """The occupancies [n] of pixels [n, C]."""
    colours = pixels if about.mode == "trinary" else pixels[:, :3]
    shade = colours.sum(axis=1, dtype=np.float64) / colours.shape[1]
    if about.mode == "raw":
        whole = np.floor(255 * (shade / FULL) + 0.5)
        return np.where(whole <= OCCUPIED_PERCENT, whole, UNKNOWN_PERCENT).astype(np.int8)
    probability = shade / FULL if about.negate else 1.0 - shade / FULL
    inner = np.full(len(pixels), float(UNKNOWN_PERCENT))
    width = about.occupied - about.free
    if about.mode == "scale" and between and width > 0:
        inner = np.rint(100.0 * (probability - about.free) / width)
    found = np.where(probability < about.free, FREE_PERCENT, inner)
    found[probability > about.occupied] = OCCUPIED_PERCENT
    if about.mode == "scale" and pixels.shape[1] == 4:
        found[pixels[:, 3] < FULL] = UNKNOWN_PERCENT
    return found.astype(np.int8)


def _warn_of_thresholds(path: Path, about: MapFile, pixels: NDArray[np.uint16]) -> None:
    """Warn where all greys are map_saver's and the thresholds, as its 0.25 of years, make its 205 of unknown known."""
    grey = (pixels[..., 0] >> 8).ravel()
    if about.mode == "raw" or (pixels[..., :3] != pixels[..., :1]).any():
        return
    counts, unknown = np.bincount(grey, minlength=256), UNKNOWN_GREY
    if about.negate and counts[255 - UNKNOWN_GREY]:
        counts, unknown = counts[::-1], 255 - UNKNOWN_GREY  # a negative of map_saver's
    there = set(np.flatnonzero(counts).tolist())
    if not {UNKNOWN_GREY} < there <= {FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY, 255}:
        return
    one = pixels.reshape(1, -1, pixels.shape[2])[:, [int(np.argmax(grey == unknown))]]
    read = int(_occupancies(one, about, between=False)[0, 0])
    if read != UNKNOWN_PERCENT:
        what = f"grey {unknown}, which map_saver writes for unknown, is read as {'occupied' if read else 'free'}"
        why = f"by free_thresh {about.free:g}, occupied_thresh {about.occupied:g} and negate {int(about.negate)}"
        cells = f"{counts[UNKNOWN_GREY]} of {counts.sum()} cells count as known, so map_known is too high"
        mend = "" if read else ": free_thresh: 0.196 would leave them unknown"
        warnings.warn(MoteslamWarning(f"{path}: {what} {why}; {cells}{mend}"), stacklevel=4)


def _write_yaml(image: Path, raster: Raster, before: dict[str, Any], after: Mapping[str, Any]) -> None:
    """Write the YAML file beside an image, under its name: with more keys before and after its place."""
    import yaml

    place = {"resolution": float(raster.cell_size), "origin": [float(value) for value in raster.origin]}
    about = {"image": image.name, **before, **place, **after}
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True, width=float("inf"))
    write_atomically(image.with_suffix(".yaml"), text)


def _raster(values: NDArray[Any], about: MapFile) -> Raster:
    """Values [rows, columns] of an image as a raster that nobody writes to, the smallest y first."""
    values = np.ascontiguousarray(values[::-1], np.int8)
    values.setflags(write=False)
    return Raster(values, about.resolution, about.origin)
