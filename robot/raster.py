"""Values in square cells of the plane, a map, a floor plan, a coloured floor; their files, and pictures in bytes.

A map's file is an ``.npz`` of arrays by their names, with ``cell_size`` and ``origin``. Row 0 has the smallest y, in
the file as in memory. Nothing is pickled.
"""

import io
import math
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from moteslam.errors import InputError
from moteslam.files import Shape, read_arrays, write_atomically
from moteslam.robot import se2
from moteslam.robot.values import Summarised, expect_type, given_up

MAX_BYTES = 1 << 30  # Of all arrays of a file: 1 GiB, of log-odds in cells of 5 cm the square of 800 m
MAX_PLACE = 1e6  # No map lies farther from its frame's origin [m]

GRIDS = 4
"""Directions of the grid: a wall along the edges of the cells of one alone would count once or twice by chance."""
LARGEST_GRID = 1 << 27  # Cells of larger grids, 580 m square in cells of 5 cm, are counted by sorting

PNG = b"\x89PNG\r\n\x1a\n"  # What a PNG begins with
FULL = 65535  # What the largest value of a channel becomes

_GAP = rb"(?:[ \t\n\v\f\r]|#[^\n\r]*[\n\r])+"
_NETPBM = re.compile(rb"P[2356]" + 3 * (_GAP + rb"(\d{1,9})"))
_LONGEST_HEADER = 1 << 16


@dataclass(frozen=True, eq=False, repr=False)
class Raster(Summarised):
    """Values in square cells. Row 0 has the smallest y, in memory; files have it at the largest.

    Attributes:
        values: [H, W] or [H, W, C], of any type.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].
    """

    values: NDArray[Any]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        if not isinstance(self.values, np.ndarray):
            object.__setattr__(self, "values", np.array(self.values))
        if self.values.ndim not in (2, 3):
            raise InputError(f"values of {self.values.shape}, expected [H, W] or [H, W, C]")
        if not (math.isfinite(self.cell_size) and self.cell_size > 0):
            raise InputError(f"cells of {self.cell_size} m, expected a positive size")

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns."""
        return self.values.shape[0], self.values.shape[1]

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom and top [m] of a raster that is not turned, as pictures of it need them."""
        (rows, columns), (x, y, _) = self.shape, self.origin
        return x, x + columns * self.cell_size, y, y + rows * self.cell_size

    def to_world(self, places: ArrayLike) -> NDArray[np.float64]:
        """Places [n, 2] in columns and rows (cell [0, 0] from (0, 0) to (1, 1)) as points [n, 2] [m]."""
        return se2.transform_points(self.origin, np.asarray(places, np.float64).reshape(-1, 2) * self.cell_size)

    def centres(self, cells: ArrayLike) -> NDArray[np.float64]:
        """The centres [n, 2] [m] of cells [n, 2] (row, column)."""
        return self.to_world(np.asarray(cells).reshape(-1, 2)[:, ::-1] + 0.5)

    def values_at(self, points: ArrayLike, *, outside: Any) -> NDArray[Any]:
        """The values [n] or [n, C] of the cells that points [n, 2] [m] lie in; beyond the edges ``outside``."""
        points = np.asarray(points, np.float64).reshape(-1, 2)
        at = np.floor(se2.transform_points(se2.inverse(self.origin), points) / self.cell_size)
        rows, columns = self.shape
        inside = (at >= 0).all(1) & (at[:, 0] < columns) & (at[:, 1] < rows)
        found = np.full((len(at), *self.values.shape[2:]), outside, self.values.dtype)
        column, row = at[inside].astype(np.int64).T
        found[inside] = self.values[row, column]
        return found

    def _summary(self) -> str:
        height, width = (count * self.cell_size for count in self.shape)
        what = f"{self.values.dtype}{list(self.values.shape)}"
        return f"{what}, {width:.1f} x {height:.1f} m in cells of {self.cell_size:g} m"


def cells_of(points: NDArray[np.float64], size: float) -> Iterator[NDArray[np.int64]]:
    """For each direction of the grid the numbers [p], from 0 on, of the cells that points [p, 2] lie in; all in m."""
    x, y = np.ascontiguousarray(points.T) / size
    for angle in np.arange(1, GRIDS + 1) * (np.pi / 2 / (GRIDS + 1)):
        c, s = np.cos(angle), np.sin(angle)
        columns, rows = np.floor(c * x + s * y), np.floor(c * y - s * x)
        columns, rows = columns - columns.min(), rows - rows.min()
        yield (rows * (int(columns.max()) + 1) + columns).astype(np.int64)


def cell_counts(points: NDArray[np.float64], size: float) -> NDArray[np.int64]:
    """The number of different cells that hold a point, for each direction [GRIDS] of the grid; see ``cells_of``.

    Of two maps of the same scans the one that needs fewer is sharper.
    """
    return np.array([_distinct(cells) for cells in cells_of(points, size)])


def _distinct(cells: NDArray[np.int64]) -> int:
    if int(cells.max()) >= LARGEST_GRID:
        return len(np.unique(cells))
    seen = np.zeros(int(cells.max()) + 1, bool)
    seen[cells] = True
    return int(np.count_nonzero(seen))


def write_map_arrays(path: str | PathLike[str], rasters: Mapping[str, Raster]) -> None:
    """Write rasters of one place, by their names, as ``.npz``, compressed; the same rasters give the same bytes."""
    expect_type(rasters, Mapping, "rasters", "rasters by their names")
    place = next(iter(rasters.values()))
    arrays: dict[str, Any] = {name: raster.values for name, raster in rasters.items()}
    arrays |= {"cell_size": np.float64(place.cell_size), "origin": np.array(place.origin, np.float64)}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def read_map_arrays(path: str | PathLike[str], name: str = "log_odds") -> Raster:
    """Read one of the rasters that `write_map_arrays` wrote, bit for bit; an array of another program may do as well.

    Raises:
        InputError: no ``.npz`` file, arrays that are missing, of other shapes or of more than 1 GiB, or values that
            are not finite or out of bounds; file and field are named.
    """
    path = Path(path)
    depth: Shape = (3,) if name == "colours" else ()
    shapes: dict[str, Shape] = {name: ("rows", "columns", *depth), "cell_size": (), "origin": (3,)}
    found = read_arrays(path, shapes, max_bytes=MAX_BYTES)
    cell_size, origin = float(found["cell_size"].item()), tuple(map(float, found["origin"]))
    for field, fine in (
        (name, np.isfinite(found[name]).all()),
        ("cell_size", 0 < cell_size <= MAX_PLACE),
        ("origin", all(abs(value) <= MAX_PLACE for value in origin)),
    ):
        if not fine:
            raise InputError(f"expected finite numbers within {MAX_PLACE:g}", file=path, field=field)
    x, y, yaw = origin
    return Raster(given_up(found[name]), cell_size, (x, y, yaw))


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a picture declares; None if the format is not known here."""
    if data.startswith(PNG) and len(data) >= 24:
        return int.from_bytes(data[16:20]), int.from_bytes(data[20:24])
    if header := _NETPBM.match(data[:_LONGEST_HEADER]):
        return int(header[1]), int(header[2])
    from PIL import Image, UnidentifiedImageError

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of sizes, which callers check
        try:
            with Image.open(io.BytesIO(data)) as image:
                width, height = image.size
                return width, height
        except (UnidentifiedImageError, Image.DecompressionBombError, OSError, ValueError):
            return None


def decode_picture(data: bytes, how: int) -> NDArray[Any] | None:
    """A picture as OpenCV decodes it with an ``IMREAD_`` flag; None if that fails, or it is cut short or damaged."""
    import cv2

    is_png, log = data.startswith(PNG), cv2.utils.logging
    if not data or (is_png and not _is_complete_png(data)):
        return None
    # PNG comes on many threads at once: nothing of all the process is touched
    level = None if is_png else log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), how)
    except cv2.error:
        return None
    finally:
        if level is not None:
            log.setLogLevel(level)


def _is_complete_png(data: bytes) -> bool:
    """Whether every checksum of a PNG up to its end is right; OpenCV would fill in what is missing."""
    from PIL import Image

    try:
        Image.open(io.BytesIO(data)).verify()
    except Exception:  # Pillow and its unpackers raise half a dozen kinds
        return False
    return True


def decode_channels(data: bytes) -> NDArray[np.uint16] | None:
    """All channels of a picture as the file has them, with 65535 for the largest value of a channel.

    [H, W, C]: grey, or red, green and blue, or these and opacity; None if the data cannot be decoded, are cut short or
    damaged, or hold other than whole numbers of up to 16 bits; and for Netpbm files whose largest value is neither 255
    nor 65535, since OpenCV does not scale by it.
    """
    import cv2

    header = _NETPBM.match(data[:_LONGEST_HEADER])
    if header is not None and int(header[3]) not in (255, FULL):
        return None
    end = b"\n" if data[:2] in (b"P2", b"P3") else b""  # OpenCV wants it behind the last number of a text
    image = decode_picture(data + end, cv2.IMREAD_UNCHANGED)
    if image is None or image.dtype not in (np.uint8, np.uint16):
        return None
    image = image if image.ndim == 3 else image[:, :, None]
    order = [0, 1, 2, 3] if image.shape[2] == 1 else [2, 1, 0, 3]  # OpenCV has blue first
    image = image[:, :, order[: image.shape[2]]]
    return image if image.dtype == np.uint16 else image * np.uint16(FULL // 255)


def encode_png(image: NDArray[Any], *, fast: bool = False) -> bytes:
    """A PNG of an image.

    Args:
        image: [H, W] grey, [H, W, 3] red, green, blue or [H, W, 4] with opacity; uint8 or uint16.
        fast: predict each pixel from its left neighbour and seek no repeats: of what the encoder offers, twice as fast
            as its default for images of a camera, and smaller.
    """
    import cv2

    options = [
        *(cv2.IMWRITE_PNG_COMPRESSION, 1),
        *(cv2.IMWRITE_PNG_STRATEGY, cv2.IMWRITE_PNG_STRATEGY_HUFFMAN_ONLY),
        *(cv2.IMWRITE_PNG_FILTER, cv2.IMWRITE_PNG_FILTER_SUB),
    ]
    if image.ndim == 3:
        order = cv2.COLOR_RGB2BGR if image.shape[2] == 3 else cv2.COLOR_RGBA2BGRA
        image = cv2.cvtColor(np.ascontiguousarray(image), order)
    return bytes(cv2.imencode(".png", np.ascontiguousarray(image), options if fast else [])[1].data)
