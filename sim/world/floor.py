"""What the floor looks like: a pattern of arithmetic, or a picture, and rasters of either.

The colour at a point depends on the point and the floor's seed alone, so two rasters of a floor agree wherever they
overlap.
"""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache
from typing import Annotated, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field, model_validator

from moteslam.errors import ConfigError, InputError
from moteslam.robot.files import read_bytes
from moteslam.robot.pictures import decode_picture, picture_size
from moteslam.robot.raster import Raster
from moteslam.robot.tables import Number, Positive, Section, Share, Whole
from moteslam.sim.world.floor_patterns import PATTERNS, stain_shade
from moteslam.sim.world.value_noise import Array

Level = Annotated[Whole, Field(ge=0, le=255)]

MAX_PIXELS = 200_000_000
"""A raster larger than this is refused: at 1 cm, 140 m by 140 m."""


MAX_PICTURE_BYTES, MAX_PICTURE_PIXELS = 100_000_000, 64_000_000
"""Of a floor's picture."""


class FloorSettings(Section):
    """A floor.

    Attributes:
        material: ``tiles``: squares, each of a colour of its own, with joints; ``carpet``: blotches with a pile;
            ``wood``: planks with grain, in staggered rows along x; ``plain``: one colour; ``image``: a picture.
        seed: of the choice of colours; the floor does not depend on the seed of a run.
        size: edge of a tile, width of a plank, size of a blotch [m]; 0.5, 0.14 and 0.8 by default.
        colours: that the material is made of, (red, green, blue) from 0 to 255; each material has its own.
        stains: share of the floor under stains, which darken it.
        image: a picture file, repeated over the floor (``image`` only), in the scenario's folder or below.
        image_width: how wide it lies on the floor [m]; its height follows. Its lower left corner lies at (0, 0).
    """

    material: Literal["tiles", "carpet", "wood", "plain", "image"] = "tiles"
    seed: Annotated[Whole, Field(ge=0, lt=2**63)] = 0
    size: Annotated[Number, Field(ge=0.02, le=100)] | None = None
    colours: Annotated[tuple[tuple[Level, Level, Level], ...], Field(min_length=1, max_length=64)] | None = None
    stains: Share = 0.0
    image: str | None = None
    image_width: Positive = 4.0

    @model_validator(mode="after")
    def _has_an_image_if_it_needs_one(self) -> FloorSettings:
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
        colours = self._picture_at(x, y) if self.image is not None else self._pattern_at(x, y)
        if self.stains > 0:
            colours = colours * stain_shade(x, y, self.stains, self.seed)[:, None]
        return np.rint(np.clip(colours, 0, 255)).astype(np.uint8).reshape(*points.shape[:-1], 3)

    def _pattern_at(self, x: Array, y: Array) -> Array:
        pattern = PATTERNS[self.material]
        palette = np.asarray(self.colours or pattern.palette, np.float64)
        return pattern.draw(x, y, self.size or pattern.size, palette, self.seed)

    def _picture_at(self, x: Array, y: Array) -> Array:
        assert self.image is not None
        picture = _read_picture(self.image)
        height, width = picture.shape[:2]
        scale = width / self.image_width  # pixels a metre
        col = np.floor(x * scale).astype(np.int64) % width
        row = np.floor(y * scale).astype(np.int64) % height
        return np.asarray(picture[row, col], np.float64)


def rasterise(
    floor: FloorSettings, bounds: tuple[float, float, float, float], cell_size: float, *, samples: int = 1
) -> Raster:
    """The floor as a raster, a cell the mean of samples x samples points in it.

    Args:
        floor: what to draw.
        bounds: x_min, y_min, x_max, y_max [m]; the cells lie on the lattice of multiples of ``cell_size``.
        cell_size: [m].
        samples: along each side of a cell.

    Returns:
        uint8 values [H, W, 3]: red, green, blue.

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
    return Raster(colours, cell_size, (float(low[0] * cell_size), float(low[1] * cell_size), 0.0))


@lru_cache(maxsize=4)
def _read_picture(path: str) -> NDArray[np.uint8]:
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
