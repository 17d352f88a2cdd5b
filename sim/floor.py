"""What the floor looks like: materials made of arithmetic, defined in world metres at any resolution, or a picture.

A material's colour at a point depends on the point and the seed alone (a hash of the lattice cell it lies in), never
on what was asked before: two rasters of the same floor agree wherever they meet.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError
from moteslam.robot.files import write_atomically
from moteslam.robot.pictures import decode_picture
from moteslam.robot.section import Number, Positive, Section, Share, Whole

Array = NDArray[np.float64]
Level = Annotated[Whole, Field(ge=0, le=255)]
Rgb = tuple[Level, Level, Level]

MAX_PIXELS = 200_000_000
"""A raster larger than this is refused: at 1 cm, 140 m by 140 m."""

_PALETTES: dict[str, tuple[Rgb, ...]] = {
    "tiles": ((238, 232, 218), (176, 92, 66), (52, 60, 74), (128, 146, 112), (24, 24, 28), (208, 178, 120)),
    "carpet": ((34, 52, 96), (196, 176, 140), (122, 30, 40)),
    "wood": ((150, 98, 54), (110, 66, 34), (186, 136, 84), (84, 50, 28), (206, 168, 118)),
    "plain": ((128, 126, 122),),
}
_SIZES = {"tiles": 0.5, "carpet": 0.8, "wood": 0.14, "plain": 1.0}


class FloorSettings(Section):
    """A floor.

    Attributes:
        material: ``tiles``: squares, each of a colour of its own, with joints; ``carpet``: blotches with a pile;
            ``wood``: planks with grain, in staggered rows along x; ``plain``: one colour; ``image``: a picture.
        seed: of the choice of colours; the floor does not depend on the seed of a run.
        size: edge of a tile, width of a plank, size of a blotch [m]; 0.5, 0.14 and 0.8 by default.
        colours: that the material is made of, (red, green, blue) from 0 to 255; each material has its own.
        stains: share of the floor under stains, which darken it.
        image: a picture file, repeated over the floor (``image`` only), relative to the scenario's file.
        image_width: how wide it lies on the floor [m]; its height follows. Its lower left corner lies at (0, 0).
    """

    material: Literal["tiles", "carpet", "wood", "plain", "image"] = "tiles"
    seed: Annotated[Whole, Field(ge=0, lt=2**63)] = 0
    size: Annotated[Number, Field(ge=0.02, le=100)] | None = None
    colours: Annotated[tuple[Rgb, ...], Field(min_length=1, max_length=64)] | None = None
    stains: Share = 0.0
    image: str | None = None
    image_width: Positive = 4.0

    @model_validator(mode="after")
    def _image_where_one_is_asked_for(self) -> FloorSettings:
        if (self.material == "image") != (self.image is not None):
            raise ValueError('material "image" and an image belong together, expected both or neither')
        return self

    def check_picture(self) -> None:
        """Read the picture, if it has one.

        Raises:
            ConfigError: it cannot be read.
        """
        if self.image is not None:
            _read_picture(self.image)

    def colours_at(self, points: ArrayLike) -> NDArray[np.uint8]:
        """The colours uint8 [..., 3] of the floor at points [..., 2] in the world [m].

        Raises:
            ConfigError: the picture cannot be read.
        """
        points = np.asarray(points, np.float64)
        flat = np.ascontiguousarray(points.reshape(-1, 2))
        if not len(flat):
            return np.empty((*points.shape[:-1], 3), np.uint8)
        x, y = flat.T.copy()
        colours = _image_at(self, x, y) if self.material == "image" else _MATERIALS[self.material](self, x, y)
        if self.stains > 0:
            colours = colours * _stains(self, x, y)[:, None]
        return np.rint(np.clip(colours, 0, 255)).astype(np.uint8).reshape(*points.shape[:-1], 3)


@dataclass(frozen=True, eq=False)
class FloorImage:
    """A floor as a grid of colours.

    Attributes:
        colours: [H, W, 3] uint8 red, green, blue; row 0 the smallest y.
        origin: (x, y) of the corner of cell [0, 0] [m].
        cell_size: [m].
    """

    colours: NDArray[np.uint8]
    origin: tuple[float, float]
    cell_size: float


def rasterise(
    floor: FloorSettings, bounds: tuple[float, float, float, float], cell_size: float, *, samples: int = 1
) -> FloorImage:
    """The floor as a picture, a cell the mean of samples x samples points in it.

    Args:
        floor: what to draw.
        bounds: x_min, y_min, x_max, y_max [m]; the cells lie on the lattice of multiples of ``cell_size``.
        cell_size: [m].
        samples: along each side of a cell.

    Raises:
        ConfigError: more than ``MAX_PIXELS`` cells, or a picture that cannot be read.
    """
    low = np.floor(np.asarray(bounds[:2]) / cell_size + 1e-9).astype(np.int64)
    width, height = (int(n) for n in np.ceil(np.asarray(bounds[2:]) / cell_size - 1e-9).astype(np.int64) - low)
    width, height = max(width, 1), max(height, 1)
    if width * height * samples**2 > MAX_PIXELS:
        raise ConfigError(f"{width} x {height} cells, expected at most {MAX_PIXELS}", field="floor")
    colours = np.empty((height, width, 3), np.uint8)
    offsets = (np.arange(samples) + 0.5) / samples
    x = ((low[0] + np.arange(width))[:, None] + offsets).reshape(-1) * cell_size

    def draw(rows: range) -> None:
        y = ((low[1] + np.array(rows))[:, None] + offsets).reshape(-1) * cell_size
        seen = floor.colours_at(np.stack(np.broadcast_arrays(x[None, :], y[:, None]), axis=-1))
        if samples > 1:
            shaped = seen.reshape(len(rows), samples, width, samples, 3)
            seen = np.rint(shaped.mean(axis=(1, 3))).astype(np.uint8)
        colours[rows.start : rows.stop] = seen

    step = max(1, 200_000 // (width * samples**2))
    bands = [range(start, min(start + step, height)) for start in range(0, height, step)]
    with ThreadPoolExecutor() as pool:
        list(pool.map(draw, bands))
    return FloorImage(colours, (float(low[0] * cell_size), float(low[1] * cell_size)), cell_size)


def write_floor(path: str | PathLike[str], image: FloorImage) -> None:
    """Write a floor as a PNG, a pixel a cell, the largest y on top, and where it lies as ``.yaml`` beside it.

    Raises:
        OutputError: one of them cannot be written.
    """
    import cv2

    path = Path(path)
    write_atomically(path, cv2.imencode(".png", np.ascontiguousarray(image.colours[::-1, :, ::-1]))[1].tobytes())
    x, y = image.origin
    write_atomically(
        path.with_suffix(".yaml"),
        f"image: {path.name}\nresolution: {image.cell_size!r}\norigin: [{x!r}, {y!r}, 0.0]\n",
    )


def _tiles(floor: FloorSettings, x: Array, y: Array) -> Array:
    size = floor.size or _SIZES["tiles"]
    col, row = np.floor(x / size), np.floor(y / size)
    colours = _palette(floor)[_pick(floor, col, row, 1)]
    shade = 0.9 + 0.2 * _uniform(col, row, floor.seed, 2) + 0.08 * (_noise(x / 0.05, y / 0.05, floor.seed, 3) - 0.5)
    joint = 0.005  # half a joint of one centimetre
    off_x, off_y = np.abs(x - (col + 0.5) * size), np.abs(y - (row + 0.5) * size)
    colours *= shade[:, None]
    colours[np.maximum(off_x, off_y) > size / 2 - joint] = 96.0
    return np.asarray(colours)


def _carpet(floor: FloorSettings, x: Array, y: Array) -> Array:
    size, palette = floor.size or _SIZES["carpet"], _palette(floor)
    level = _noise(x / size, y / size, floor.seed, 1) + 0.4 * _noise(2.7 * x / size, 2.7 * y / size, floor.seed, 2)
    rank = np.clip((level - 0.25) / 0.9, 0, 0.999)  # most of the noise lies there
    colours = palette[(rank * len(palette)).astype(np.int64)]
    pile = 0.8 + 0.4 * _uniform(np.floor(x / 0.01), np.floor(y / 0.01), floor.seed, 3)
    return np.asarray(colours * pile[:, None])


def _wood(floor: FloorSettings, x: Array, y: Array) -> Array:
    width = floor.size or _SIZES["wood"]
    length = 8 * width
    row = np.floor(y / width)
    along = x / length + _uniform(row, row, floor.seed, 1)  # each row is staggered by its own share of a plank
    plank = np.floor(along)
    colours = _palette(floor)[_pick(floor, plank, row, 2)]
    grain = 0.85 + 0.3 * _noise(x / 0.25, y / 0.012, floor.seed, 3)
    edge = np.minimum((along - plank) * length, y - row * width) < 0.003
    return np.where(edge[:, None], 20.0, colours * grain[:, None])


def _plain(floor: FloorSettings, x: Array, y: Array) -> Array:
    shade = 0.95 + 0.1 * _noise(x / 0.05, y / 0.05, floor.seed, 1)
    return np.asarray(_palette(floor)[0] * shade[:, None])


_MATERIALS: dict[str, Callable[[FloorSettings, Array, Array], Array]] = {
    "tiles": _tiles,
    "carpet": _carpet,
    "wood": _wood,
    "plain": _plain,
}


def _image_at(floor: FloorSettings, x: Array, y: Array) -> Array:
    assert floor.image is not None
    picture = _read_picture(floor.image)
    height, width = picture.shape[:2]
    scale = width / floor.image_width  # pixels a metre
    col = np.floor(x * scale).astype(np.int64) % width
    row = np.floor(y * scale).astype(np.int64) % height
    return np.asarray(picture[row, col], np.float64)


@lru_cache(maxsize=4)
def _read_picture(path: str) -> NDArray[np.uint8]:
    """A picture as uint8 [H, W, 3] red, green, blue, row 0 the lowest."""
    import cv2

    try:
        data = Path(path).read_bytes()
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path}: {said}, expected a picture", field="floor.image") from error
    picture = decode_picture(data, cv2.IMREAD_COLOR)
    if picture is None:
        raise ConfigError(f"{path}: no picture that can be read, expected a whole PNG or JPEG", field="floor.image")
    return np.ascontiguousarray(picture[::-1, :, ::-1], np.uint8)


def _palette(floor: FloorSettings) -> Array:
    return np.asarray(floor.colours or _PALETTES[floor.material], np.float64)


def _pick(floor: FloorSettings, col: Array, row: Array, layer: int) -> NDArray[np.int64]:
    """Which colour of the palette each lattice cell has."""
    return np.asarray((_uniform(col, row, floor.seed, layer) * len(_palette(floor))).astype(np.int64))


def _stains(floor: FloorSettings, x: Array, y: Array) -> Array:
    """What stains leave of the light, 0.45 to 1: where smooth noise is among its largest ``stains``."""
    level = (_noise(x / 0.7, y / 0.7, floor.seed, 8) + 0.5 * _noise(x / 0.2, y / 0.2, floor.seed, 9)) / 1.5
    # the noise is near to a normal distribution of this mean and spread (measured)
    from scipy.special import ndtri

    threshold = 0.5 + 0.17 * float(ndtri(1 - min(floor.stains, 1 - 1e-9)))
    return np.asarray(1 - 0.55 * np.clip((level - threshold) / 0.04, 0, 1))


def _noise(u: Array, v: Array, seed: int, layer: int) -> Array:
    """Smooth noise in [0, 1]: uniform on the lattice of whole numbers, blended between."""
    i, j = np.floor(u), np.floor(v)
    s, t = u - i, v - j
    s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
    (low_i, low_j), across = (i.min(), j.min()), int(np.ptp(i)) + 2
    if across * (np.ptp(j) + 2) <= 2 * len(u):  # points lie densely: hash each corner of the lattice once
        rows, columns = np.mgrid[0 : int(np.ptp(j)) + 2, 0:across].astype(np.float64)
        table = _hash(columns.reshape(-1) + low_i, rows.reshape(-1) + low_j, seed, layer)
        corner = ((j - low_j) * across + (i - low_i)).astype(np.int64)
        a, b, c, d = (table[corner + step] for step in (0, 1, across, across + 1))
    else:
        a, b, c, d = (_hash(i + right, j + up, seed, layer) for up in (0, 1) for right in (0, 1))
    below, above = a + s * (b - a), c + s * (d - c)
    return np.asarray(below + t * (above - below))


def _uniform(i: Array, j: Array, seed: int, layer: int) -> Array:
    """``_hash``, the cells hashed once each where many points lie in the same ones."""
    low_i, low_j, across = i.min(), j.min(), int(np.ptp(i)) + 1
    if across * (np.ptp(j) + 1) > len(i) / 2:
        return _hash(i, j, seed, layer)
    rows, columns = np.mgrid[0 : int(np.ptp(j)) + 1, 0:across].astype(np.float64)
    table = _hash(columns.reshape(-1) + low_i, rows.reshape(-1) + low_j, seed, layer)
    return np.asarray(table[((j - low_j) * across + (i - low_i)).astype(np.int64)])


def _hash(i: Array, j: Array, seed: int, layer: int) -> Array:
    """A number in [0, 1) for each lattice cell (i, j), layer and seed: a multiply-xor-shift hash of 64 bits."""
    key = np.uint64((seed * 0x9E3779B97F4A7C15 + layer * 0xD1B54A32D192ED03 + 0x8CB92BA72F3D8DD7) % 2**64)
    h = i.astype(np.int64).view(np.uint64) * np.uint64(0xBF58476D1CE4E5B9)
    h ^= j.astype(np.int64).view(np.uint64) * np.uint64(0x94D049BB133111EB) + key
    for shift, factor in ((30, 0xFF51AFD7ED558CCD), (31, 0xC4CEB9FE1A85EC53)):
        h ^= h >> np.uint64(shift)
        h *= np.uint64(factor)
    h ^= h >> np.uint64(32)
    return (h >> np.uint64(11)).astype(np.float64) * 2.0**-53
