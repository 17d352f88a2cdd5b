"""What the floor looks like: a pattern of arithmetic, or a picture, and rasters of either.

The colour at a point depends on the point and the floor's seed alone (a hash of lattice points), so two rasters of
a floor agree wherever they overlap.
"""

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Annotated, Literal, Self

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError, InputError
from moteslam.files import read_bytes
from moteslam.robot.raster import Raster, decode_picture, picture_size
from moteslam.robot.se2 import Array
from moteslam.robot.values import Number, Positive, Section, Share, Whole


def smooth_noise(u: Array, v: Array, seed: int, layer: int) -> Array:
    """Numbers [n] from 0 to 1 at (u, v) [n], uniform at whole coordinates and blended between them."""
    i, j = np.floor(u), np.floor(v)
    s, t = u - i, v - j
    s, t = s * s * (3 - 2 * s), t * t * (3 - 2 * t)
    a, b, c, d = (cell_noise(i + right, j + up, seed, layer) for up in (0, 1) for right in (0, 1))
    below, above = a + s * (b - a), c + s * (d - c)
    return np.asarray(below + t * (above - below))


def cell_noise(i: Array, j: Array, seed: int, layer: int) -> Array:
    """Independent numbers in [0, 1) of the lattice cells (i, j) [n]: a multiply-xor-shift hash of 64 bits."""
    key = np.uint64((seed * 0x9E3779B97F4A7C15 + layer * 0xD1B54A32D192ED03 + 0x8CB92BA72F3D8DD7) % 2**64)
    h = i.astype(np.int64).view(np.uint64) * np.uint64(0xBF58476D1CE4E5B9)
    h ^= j.astype(np.int64).view(np.uint64) * np.uint64(0x94D049BB133111EB) + key
    for shift, factor in ((30, 0xFF51AFD7ED558CCD), (31, 0xC4CEB9FE1A85EC53)):
        h ^= h >> np.uint64(shift)
        h *= np.uint64(factor)
    h ^= h >> np.uint64(32)
    return (h >> np.uint64(11)).astype(np.float64) * 2.0**-53


Rgb = tuple[int, int, int]
JOINT = 0.005  # Half a joint between tiles [m]


def _tiles(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    col, row = np.floor(x / size), np.floor(y / size)
    colours = _pick(palette, col, row, seed, 1)
    shade = 0.9 + 0.2 * cell_noise(col, row, seed, 2) + 0.08 * (smooth_noise(x / 0.05, y / 0.05, seed, 3) - 0.5)
    off_x, off_y = np.abs(x - (col + 0.5) * size), np.abs(y - (row + 0.5) * size)
    colours *= shade[:, None]
    colours[np.maximum(off_x, off_y) > size / 2 - JOINT] = 96.0
    return np.asarray(colours)


def _carpet(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    level = smooth_noise(x / size, y / size, seed, 1) + 0.4 * smooth_noise(2.7 * x / size, 2.7 * y / size, seed, 2)
    rank = np.clip((level - 0.25) / 0.9, 0, 0.999)  # most of the noise lies there
    colours = palette[(rank * len(palette)).astype(np.int64)]
    pile = 0.8 + 0.4 * cell_noise(np.floor(x / 0.01), np.floor(y / 0.01), seed, 3)
    return np.asarray(colours * pile[:, None])


def _wood(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    length = 8 * size
    row = np.floor(y / size)
    along = x / length + cell_noise(row, row, seed, 1)  # each row is staggered by its own share of a plank
    plank = np.floor(along)
    colours = _pick(palette, plank, row, seed, 2)
    grain = 0.85 + 0.3 * smooth_noise(x / 0.25, y / 0.012, seed, 3)
    edge = np.minimum((along - plank) * length, y - row * size) < 0.003
    return np.where(edge[:, None], 20.0, colours * grain[:, None])


def _plain(x: Array, y: Array, size: float, palette: Array, seed: int) -> Array:
    shade = 0.95 + 0.1 * smooth_noise(x / 0.05, y / 0.05, seed, 1)
    return np.asarray(palette[0] * shade[:, None])


def _pick(palette: Array, col: Array, row: Array, seed: int, layer: int) -> Array:
    """The colour [n, 3] of the palette that each lattice cell has."""
    return np.asarray(palette[(cell_noise(col, row, seed, layer) * len(palette)).astype(np.int64)])


PATTERNS: dict[str, tuple[Callable[[Array, Array, float, Array, int], Array], float, tuple[Rgb, ...]]] = {
    "tiles": (
        _tiles, 0.5, ((238, 232, 218), (176, 92, 66), (52, 60, 74), (128, 146, 112), (24, 24, 28), (208, 178, 120))
    ),
    "carpet": (_carpet, 0.8, ((34, 52, 96), (196, 176, 140), (122, 30, 40))),
    "wood": (_wood, 0.14, ((150, 98, 54), (110, 66, 34), (186, 136, 84), (84, 50, 28), (206, 168, 118))),
    "plain": (_plain, 1.0, ((128, 126, 122),)),
}  # fmt: skip
"""By name: ``draw(x, y, size, palette, seed)``, which gives colours [n, 3] (0 to 255, not clipped) at x, y [n] [m], and
the usual size of a tile, blotch or plank [m] and palette [k, 3]."""


def stain_shade(x: Array, y: Array, share: float, seed: int) -> Array:
    """The share of the light [n], 0.45 to 1, that stains leave: dark where smooth noise is in its top ``share``."""
    from scipy.special import ndtri

    level = (smooth_noise(x / 0.7, y / 0.7, seed, 8) + 0.5 * smooth_noise(x / 0.2, y / 0.2, seed, 9)) / 1.5
    # the noise is near to a normal distribution of this mean and spread (measured)
    threshold = 0.5 + 0.17 * float(ndtri(1 - min(share, 1 - 1e-9)))
    return np.asarray(1 - 0.55 * np.clip((level - threshold) / 0.04, 0, 1))


Level = Annotated[Whole, Field(ge=0, le=255)]

MAX_PIXELS = 200_000_000  # A raster larger than this is refused: at 1 cm, 140 m by 140 m
MAX_PICTURE_BYTES, MAX_PICTURE_PIXELS = 100_000_000, 64_000_000  # Of a floor's picture


class FloorSettings(Section):
    # tiles: squares, each of a colour of its own, with joints; carpet: blotches with a pile; wood: planks with grain,
    # in staggered rows along x; plain: one colour; image: a picture
    material: Literal["tiles", "carpet", "wood", "plain", "image"] = "tiles"
    # of the choice of colours; the floor does not depend on the seed of a run
    seed: Annotated[Whole, Field(ge=0, lt=2**63)] = 0
    # edge of a tile, width of a plank, size of a blotch [m]; 0.5, 0.14 and 0.8 by default
    size: Annotated[Number, Field(ge=0.02, le=100)] | None = None
    # that the material is made of, (red, green, blue) from 0 to 255; each material has its own
    colours: Annotated[tuple[tuple[Level, Level, Level], ...], Field(min_length=1, max_length=64)] | None = None
    stains: Share = 0.0  # share of the floor under stains, which darken it
    image: str | None = None  # a picture file, repeated over the floor, in the scenario's folder or below
    image_width: Positive = 4.0  # how wide it lies on the floor [m]; its lower left corner lies at (0, 0)

    @model_validator(mode="after")
    def _has_an_image_if_it_needs_one(self) -> Self:
        if (self.material == "image") != (self.image is not None):
            raise ValueError('material "image" and an image belong together, expected both or neither')
        return self

    def colours_at(self, points: ArrayLike) -> NDArray[np.uint8]:
        """The colours uint8 [..., 3] of the floor at points [..., 2] in the world [m]."""
        points = np.asarray(points, np.float64)
        flat = np.ascontiguousarray(points.reshape(-1, 2))
        x, y = flat.T.copy()
        if self.image is not None:
            picture = read_picture(self.image)
            height, width = picture.shape[:2]
            column, row = (np.floor(each * (width / self.image_width)).astype(np.int64) for each in (x, y))
            colours = np.asarray(picture[row % height, column % width], np.float64)
        else:
            draw, size, palette = PATTERNS[self.material]
            colours = draw(x, y, self.size or size, np.asarray(self.colours or palette, np.float64), self.seed)
        if self.stains > 0:
            colours = colours * stain_shade(x, y, self.stains, self.seed)[:, None]
        return np.rint(np.clip(colours, 0, 255)).astype(np.uint8).reshape(*points.shape[:-1], 3)


def rasterise(
    floor: FloorSettings, bounds: tuple[float, float, float, float], cell_size: float, *, samples: int = 1
) -> Raster:
    """The floor as a raster uint8 [H, W, 3], a cell the mean of samples x samples points in it.

    ``bounds`` are x_min, y_min, x_max, y_max [m]; the cells lie on the lattice of multiples of ``cell_size`` [m].
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
    return Raster(colours, cell_size, (float(low[0] * cell_size), float(low[1] * cell_size), 0.0))


@lru_cache(maxsize=4)
def read_picture(path: str) -> NDArray[np.uint8]:
    """A picture as uint8 [H, W, 3] red, green, blue, row 0 the lowest."""
    import cv2

    try:
        data = read_bytes(path, "a picture", limit=MAX_PICTURE_BYTES)
    except InputError as error:
        raise ConfigError(str(error), field="floor.image") from error
    width, height = picture_size(data) or (0, 0)
    if width * height > MAX_PICTURE_PIXELS:
        raise ConfigError(
            f"{path}: {width} x {height} pixels, expected at most {MAX_PICTURE_PIXELS} in all", field="floor.image"
        )
    picture = decode_picture(data, cv2.IMREAD_COLOR) if width else None
    if picture is None:
        raise ConfigError(f"{path}: no picture that can be read, expected a complete PNG or JPEG", field="floor.image")
    return np.ascontiguousarray(picture[::-1, :, ::-1], np.uint8)
