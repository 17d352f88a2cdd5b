"""Maps as ROS's map_server keeps them: an image, and a YAML file that says where it lies and what its greys mean.

A raster has row 0 at the smallest y, an image at the largest: it is flipped here, at the file, and nowhere else.

Occupancies are -1 (unknown) or 0 to 100 %, as in nav_msgs/OccupancyGrid. Source: how nav2's map_server (Foxy to Jazzy)
reads maps, in the modes trinary, scale and raw, and how map_saver writes them, in the mode trinary.
"""

import warnings
from collections.abc import Iterator, Mapping
from os import PathLike
from pathlib import Path, PureWindowsPath
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, BeforeValidator, Field, Strict, ValidationError

from moteslam.errors import InputError, MoteslamWarning, OutputError
from moteslam.files import read_bytes, read_yaml, write_atomically
from moteslam.robot.raster import FULL, MAX_PLACE, Raster, decode_channels, encode_png, picture_size
from moteslam.robot.values import expect_type, first_complaint, given_up

FREE, OCCUPIED, UNKNOWN = 0, 1, -1  # The values of a trinary map, int8
OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""map_saver's own: above the one a cell is occupied, below the other free. A grey of 205 is just not free."""
UNKNOWN_PERCENT, FREE_PERCENT, OCCUPIED_PERCENT = -1, 0, 100
FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205  # The greys that map_saver writes for them in the mode trinary
BLACK, WHITE, BLUR, MANY = 26, 229, 10, 0.01
"""Greys beyond the first two are meant to be known; a lossy picture changes greys by less than the third; and a larger
share of the cells than the last may not be read otherwise than they were meant."""

MAX_IMAGE_BYTES = 256_000_000
MAX_YAML_BYTES = 100_000
MAX_PIXELS = 64_000_000
MAX_EXTENT = 2000.0  # Of a map's longer side [m]
_BAND = 1 << 20  # Pixels that are worked on at once

Percent = NDArray[np.int8]


def _number(value: object) -> object:
    """What is text to YAML 1.1 is a number to the programs that write it, as 5e-2; a truth value is not."""
    if isinstance(value, bool):
        raise ValueError("expected a number")
    return value


Real = Annotated[float, BeforeValidator(_number)]
Threshold = Annotated[Real, Field(ge=0, le=1)]
Yaw = Annotated[Real, Field(ge=-6.3, le=6.3)]  # radians; degrees are mostly more
Place = Annotated[Real, Field(ge=-MAX_PLACE, le=MAX_PLACE)]


class MapFile(BaseModel):
    """What the YAML file says; other keys are passed over."""

    image: Annotated[str, Strict(), Field(min_length=1)]
    resolution: Annotated[Real, Field(ge=1e-4, le=2)]  # side of a cell [m]; 5 is meant for 0.05
    origin: tuple[Place, Place, Yaw]  # x, y [m] and yaw [rad] of the lower left corner of the image
    mode: Literal["trinary", "scale", "raw"] = "trinary"
    negate: Annotated[int, Strict()] | bool  # white is occupied
    occupied_thresh: Threshold
    free_thresh: Threshold


def read_map(path: str | PathLike[str]) -> Raster:
    """Read a map [H, W] as `FREE`, `OCCUPIED` and `UNKNOWN` cells, int8, of its ``.yaml``.

    What is between the thresholds is unknown in the mode ``scale``, too; the mode ``raw`` is decided as by map_saver.
    """
    about, pixels = _read(Path(path), between=False)
    percent = _occupancies(pixels, about, between=False)
    low, high = FREE_PERCENT, OCCUPIED_PERCENT
    if about.mode == "raw":
        low, high = round(100 * about.free_thresh), round(100 * about.occupied_thresh)
    return _raster(np.select([percent < 0, percent <= low, percent >= high], [UNKNOWN, FREE, OCCUPIED], UNKNOWN), about)


def read_occupancy(path: str | PathLike[str]) -> Raster:
    """Read a map as map_server publishes it: values [H, W] int8 of 0 (free) to 100 (occupied), -1 unknown."""
    about, pixels = _read(Path(path), between=True)
    return _raster(_occupancies(pixels, about, between=True), about)


def write_map(path: str | PathLike[str], raster: Raster) -> None:
    """Write a map [H, W] of `FREE`, `OCCUPIED` and `UNKNOWN` cells as map_saver does: an image and a YAML file."""
    expect_type(raster, Raster, "raster")
    path, values = Path(path), raster.values
    greys = {UNKNOWN: UNKNOWN_GREY, FREE: FREE_GREY, OCCUPIED: OCCUPIED_GREY}
    if values.ndim != 2 or not np.isin(values, list(greys)).all():
        made = f"dataclasses.replace(raster, values={trinary.__module__}.trinary(raster.values)) makes them of log-odds"
        text = f"{values.dtype}{list(values.shape)}, expected 0 free, 1 occupied, -1 unknown [H, W]; {made}"
        raise InputError(text, field="raster")
    path = path.with_suffix(".pgm") if path.suffix == ".yaml" else path
    if path.suffix not in (".pgm", ".png"):
        raise OutputError("expected a name that ends in .pgm, .png or .yaml", file=path)
    image = np.select([values[::-1] == value for value in greys], list(greys.values())).astype(np.uint8)
    pgm = b"P5\n%d %d\n255\n" % image.shape[::-1] + image.tobytes()
    write_atomically(path, encode_png(image) if path.suffix == ".png" else pgm)
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


def seamed(raster: Raster) -> bool:
    """Whether before most walls of a map unknown cells lie, and free ones beyond, as where its image was blurred."""
    from scipy.ndimage import binary_dilation

    free, walls = raster.values == FREE, raster.values == OCCUPIED
    beside, near = (binary_dilation(free, iterations=cells) for cells in (1, 3))
    return int((walls & near & ~beside).sum()) > int((walls & beside).sum())


def map_image(log_odds: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Log-odds [H, W] in greys, row 0 the largest y: white where free, black where occupied, 205 where unknown."""
    belief = np.tanh(np.asarray(log_odds, np.float64)[::-1] / 2)  # 2 p - 1: -1 free, 0 unknown, 1 occupied
    towards_free, towards_occupied = UNKNOWN_GREY - FREE_GREY, OCCUPIED_GREY - UNKNOWN_GREY
    grey = UNKNOWN_GREY + np.where(belief < 0, towards_free * belief, towards_occupied * belief)
    return np.asarray(np.rint(grey), np.uint8)


def _read(path: Path, *, between: bool) -> tuple[MapFile, NDArray[np.uint16]]:
    """The YAML file, and the pixels [rows, columns, channels] of its image, the largest y first."""
    keys = ", ".join(name for name, key in MapFile.model_fields.items() if key.is_required())
    table = read_yaml(path, f"a map_server .yaml file ({keys})", limit=MAX_YAML_BYTES)
    try:
        about = MapFile.model_validate(table)
    except ValidationError as error:
        field, problem = first_complaint(error)
        problem = f"{problem}, expected of a map_server file"
        raise InputError(problem, file=path, field=field.partition(".")[0]) from error
    if about.free_thresh > about.occupied_thresh:
        problem = f"{about.free_thresh:g}, expected at most occupied_thresh, {about.occupied_thresh:g}"
        raise InputError(problem, file=path, field="free_thresh")
    image = _image(about.image, path)
    try:
        content = read_bytes(image, "a pgm or png image", limit=MAX_IMAGE_BYTES)
    except InputError as error:
        raise InputError(f"{image.name}: {error.problem}", file=path, field="image") from error
    columns, rows = picture_size(content) or (0, 0)
    if columns * rows > MAX_PIXELS:
        raise InputError(f"{columns} x {rows} pixels, expected at most {MAX_PIXELS} in all", file=image)
    if max(columns, rows) * about.resolution > MAX_EXTENT:
        problem = f"{columns} x {rows} cells of {about.resolution:g} m, expected at most {MAX_EXTENT:g} m a side"
        raise InputError(problem, file=path, field="resolution")
    pixels = decode_channels(content) if columns * rows else None
    if pixels is None:
        problem = "not readable as an image, expected a whole png map, or a pgm of 255 or 65535 greys"
        raise InputError(problem, file=image)
    _warn_of_greys(path, about, pixels, between)
    return about, pixels


def _image(name: str, path: Path) -> Path:
    """The image's path, in the YAML file's folder or below; one of another computer is looked for beside it."""
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
        problem = f"{name!r} lies elsewhere, expected an image in the folder of this file, or below"
        raise InputError(problem, file=path, field="image")
    return image


def _occupancies(pixels: NDArray[np.uint16], about: MapFile, *, between: bool) -> Percent:
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
    width = about.occupied_thresh - about.free_thresh
    if about.mode == "scale" and between and width > 0:
        inner = np.rint(100.0 * (probability - about.free_thresh) / width)
    found = np.where(probability < about.free_thresh, FREE_PERCENT, inner)
    found[probability > about.occupied_thresh] = OCCUPIED_PERCENT
    if about.mode == "scale" and pixels.shape[1] == 4:
        found[pixels[:, 3] < FULL] = UNKNOWN_PERCENT
    return found.astype(np.int8)


def _warn_of_greys(path: Path, about: MapFile, pixels: NDArray[np.uint16], between: bool) -> None:
    """Warn of cells that are hardly meant as they are read: transparent and coloured ones, map_saver's 205 of unknown
    that is known, of a threshold of 0.25 or a lossy JPEG, black or white that is unknown, and 8 of 16 bits.
    """
    flat, names = pixels.reshape(-1, pixels.shape[2]), {-1: "unknown", 0: "free", 100: "occupied"}
    n, plain, said = len(flat), np.ones(len(flat), bool), list[str]()
    if flat.shape[1] > 1:
        clear = flat[:, -1] < FULL if flat.shape[1] == 4 else ~plain
        coloured = (np.ptp(flat[:, :3], axis=1) > FULL // 10) & ~clear
        plain = ~(clear | coloured)
        for which, what in ((clear, "transparent"), (coloured, "coloured")):
            if which.any() and about.mode != "raw":
                some = flat[which][:: 1 + which.sum() // _BAND]
                read = int(np.bincount(_of(some, about, False) + 1).argmax()) - 1
                if which is coloured or read != UNKNOWN_PERCENT:
                    said.append(f"{which.sum()} of {n} cells are {what}, most are read as {names[read]}")
    if 0 < flat.max(initial=0) < FULL // 255:
        said.append(f"16 bits a pixel, but none is brighter than {flat.max()} of 65535: all count as black")
    counts = np.bincount(flat[plain, 0] >> 8, minlength=256)
    if about.mode == "raw":
        if (high := counts[OCCUPIED_PERCENT + 1 : 255].sum()) > MANY * n:
            said.append(f"{high} of {n} cells have greys from 101 to 254, which the mode raw makes unknown")
    else:
        levels = np.repeat(np.arange(256, dtype=np.uint16)[:, None] * np.uint16(FULL // 255), flat.shape[1], axis=1)
        levels[:, 3:] = FULL
        said += _of_levels(counts, _of(levels, about, between), about)
    for what in said:
        warnings.warn(MoteslamWarning(f"{path}: {what}: its walls or free space may be wrong"), stacklevel=4)


def _of_levels(counts: NDArray[np.int64], read: Percent, about: MapFile) -> Iterator[str]:
    """What is doubtful of greys [256], by how often they stand in the image and what they are read as."""
    thresholds = f"free_thresh {about.free_thresh:g}, occupied_thresh {about.occupied_thresh:g}"
    ends = np.flatnonzero(counts)[[0, -1]] if counts.any() else np.full(2, UNKNOWN_GREY)
    if ends[0] < BLACK and ends[1] > WHITE and UNKNOWN_PERCENT in read[ends]:
        yield f"{thresholds}: its black or its white cells count as unknown"
        return
    grey = 255 - UNKNOWN_GREY if about.negate and counts[255 - UNKNOWN_GREY] else UNKNOWN_GREY  # a negative of its maps
    level = np.arange(256)
    near = np.abs(level - grey) <= BLUR
    saved = near | (level <= BLUR) | (level >= 255 - BLUR)
    known = np.where(near & np.isin(read, (FREE_PERCENT, OCCUPIED_PERCENT)), counts, 0)
    of_map_saver = counts[near].sum() < counts[saved].sum() > 0.9 * counts.sum()
    if counts[near].any() and of_map_saver and known.sum() > MANY * counts[near].sum():
        which = int(known.argmax())
        shade = f"grey {which}{'' if which == grey else f', next to {grey}'}, which map_saver writes for unknown"
        unsure = np.floor(1000 * abs(which - 255 * (grey == UNKNOWN_GREY)) / 255) / 1000  # of this shade
        mend = f"free_thresh {unsure:g}, occupied_thresh {OCCUPIED_THRESHOLD:g}, negate {grey != UNKNOWN_GREY:d}"
        mend = f": set {'mode trinary, ' * (about.mode == 'scale')}{mend}"
        why = f"is read as {'occupied' if read[which] else 'free'} by {thresholds} and negate {about.negate:d}"
        yield f"{shade}, {why}; {known.sum()} of {counts.sum()} cells count as known{mend}"


def _write_yaml(image: Path, raster: Raster, before: dict[str, Any], after: Mapping[str, Any]) -> None:
    """Write the YAML file beside an image, under its name: with more keys before and after its place."""
    import yaml

    place = {"resolution": float(raster.cell_size), "origin": [float(value) for value in raster.origin]}
    about = {"image": image.name, **before, **place, **after}
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True, width=float("inf"))
    write_atomically(image.with_suffix(".yaml"), text)


def _raster(values: NDArray[Any], about: MapFile) -> Raster:
    """Values [rows, columns] of an image as a raster that nobody writes to, the smallest y first."""
    return Raster(given_up(np.ascontiguousarray(values[::-1], np.int8)), about.resolution, about.origin)
