"""Values in square cells of the plane, a map, a floor plan, a coloured floor; their files, and pictures in bytes.

A map's file is an ``.npz`` of log-odds or of a coloured floor. Its array ``header`` holds JSON, so that
any reader of ``.npz`` files gets at all of it:

    {"format": "moteslam-map", "version": 1, "kind": "log_odds", "cell_size": 0.05, "origin": [-3.0, -2.5, 0.0],
     "units": {"log_odds": "1"}}

Row 0 of every array has the smallest y, in the file as in memory. Nothing is pickled.
"""

from __future__ import annotations

import io
import json
import math
import re
import warnings
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike, DTypeLike, NDArray
from pydantic import ConfigDict, Field

from moteslam.errors import InputError
from moteslam.robot.files import Shape, read_arrays, write_atomically
from moteslam.robot.values import Number, Section, Summarised, expect_type, frozen, validated

Array = NDArray[np.float64]
MapKind = Literal["log_odds", "texture"]

MAX_HEADER = 100_000
MAX_BYTES = 1 << 30
"""Of all arrays of a file: 1 GiB, of log-odds in cells of 5 cm the square of 800 m."""
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""
Place = Annotated[Number, Field(ge=-MAX_PLACE, le=MAX_PLACE)]

GRIDS = 4
"""Directions of the grid: a wall along the edges of the cells of one alone would count once or twice by chance."""
LARGEST_GRID = 1 << 27
"""Cells of larger grids, 580 m square in cells of 5 cm, are counted by sorting."""

PNG = b"\x89PNG\r\n\x1a\n"
"""What a PNG begins with."""
FULL = 65535
"""What the largest value of a channel becomes."""

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

    def to_world(self, places: ArrayLike) -> Array:
        """Places [n, 2] in columns and rows (cell [0, 0] from (0, 0) to (1, 1)) as points [n, 2] [m]."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        scaled = np.asarray(places, np.float64).reshape(-1, 2) * self.cell_size
        return np.asarray(scaled @ np.array([(cos, sin), (-sin, cos)]) + (x, y))

    def centres(self, cells: ArrayLike) -> Array:
        """The centres [n, 2] [m] of cells [n, 2] (row, column)."""
        return self.to_world(np.asarray(cells).reshape(-1, 2)[:, ::-1] + 0.5)

    def values_at(self, points: ArrayLike, *, outside: Any) -> NDArray[Any]:
        """The values [n] or [n, C] of the cells that points [n, 2] [m] lie in; beyond the edges ``outside``."""
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        away = np.asarray(points, np.float64).reshape(-1, 2) - (x, y)
        at = np.floor(away @ np.array([(cos, -sin), (sin, cos)]) / self.cell_size)
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


def cells_of(points: Array, size: float) -> Iterator[NDArray[np.int64]]:
    """For each direction of the grid the numbers [p], from 0 on, of the cells that points [p, 2] lie in; all in m."""
    x, y = np.ascontiguousarray(points.T) / size
    for angle in np.arange(1, GRIDS + 1) * (np.pi / 2 / (GRIDS + 1)):
        c, s = np.cos(angle), np.sin(angle)
        columns, rows = np.floor(c * x + s * y), np.floor(c * y - s * x)
        columns, rows = columns - columns.min(), rows - rows.min()
        yield (rows * (int(columns.max()) + 1) + columns).astype(np.int64)


def mean_cells(points: Array, size: float) -> float:
    """The mean number of different cells that hold a point, over the directions of the grid; see ``cells_of``."""
    return float(cell_counts(points, size).mean())


def cell_counts(points: Array, size: float) -> NDArray[np.int64]:
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


class _Array(NamedTuple):
    """An array of a kind of map: its dtype, and its size beyond rows and columns."""

    dtype: DTypeLike
    depth: tuple[int, ...] = ()


ARRAYS: dict[MapKind, dict[str, _Array]] = {
    "log_odds": {"log_odds": _Array(np.float32)},
    "texture": {"colours": _Array(np.uint8, (3,)), "points": _Array(np.uint32)},
}
"""The arrays of each kind; of log-odds and points 0 is unknown."""


class _Header(Section):
    """What a file says beside its arrays; other keys are passed over."""

    model_config = ConfigDict(frozen=True, extra="ignore")

    format: Literal["moteslam-map"] = "moteslam-map"
    version: Literal[1] = 1
    kind: MapKind
    cell_size: Annotated[Number, Field(gt=0, le=MAX_PLACE)]
    origin: tuple[Place, Place, Place]


@dataclass(frozen=True, eq=False, repr=False, kw_only=True)
class MapArrays(Summarised):
    """A map as arrays; a `ConfigError` or `InputError` names the attribute or array that cannot be.

    Attributes:
        kind: ``log_odds`` or ``texture``.
        arrays: of that kind (`ARRAYS`), each [H, W] or [H, W, 3], row 0 the smallest y: ``log_odds``, above 0 occupied;
            ``colours``, red, green and blue, and of how many ``points`` they are the mean.
        cell_size: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].
    """

    kind: MapKind
    arrays: Mapping[str, NDArray[Any]]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def __post_init__(self) -> None:
        validated(_Header, {"kind": self.kind, "cell_size": self.cell_size, "origin": self.origin})
        wanted = ARRAYS[self.kind]
        if set(self.arrays) != set(wanted):
            raise InputError(f"{', '.join(self.arrays) or 'none'}, expected {', '.join(wanted)}", field="arrays")
        size = np.shape(next(iter(self.arrays.values())))[:2]
        arrays = {name: _checked(name, self.arrays[name], size, about) for name, about in wanted.items()}
        object.__setattr__(self, "arrays", arrays)

    def raster(self, name: str) -> Raster:
        """One of the arrays, where it lies."""
        return Raster(self.arrays[name], self.cell_size, self.origin)


def _checked(name: str, array: ArrayLike, size: tuple[int, ...], about: _Array) -> NDArray[Any]:
    values, kind = np.asarray(array), np.dtype(about.dtype)
    if values.shape != (*size, *about.depth) or len(size) != 2 or 0 in size or values.dtype.kind not in "fiu":
        wanted = ", ".join(["H", "W", *map(str, about.depth)])
        raise InputError(f"{values.dtype}{list(values.shape)}, expected numbers [{wanted}]", field=name)
    bounds = np.finfo(kind) if kind.kind == "f" else np.iinfo(kind)
    if not ((values >= bounds.min) & (values <= bounds.max)).all():
        raise InputError(f"expected finite values from {bounds.min:g} to {bounds.max:g}", field=name)
    return frozen(values, kind)


def write_map_arrays(path: str | PathLike[str], map_arrays: MapArrays) -> None:
    """Write a map as ``.npz``, compressed; the same map gives the same bytes, and reads back the same, bit for bit."""
    expect_type(map_arrays, MapArrays, "map_arrays")
    header = _Header(kind=map_arrays.kind, cell_size=map_arrays.cell_size, origin=map_arrays.origin).model_dump()
    header["units"] = dict.fromkeys(map_arrays.arrays, "1")
    content = np.frombuffer(json.dumps(header, allow_nan=False).encode(), np.uint8)
    arrays: dict[str, Any] = {"header": content, **map_arrays.arrays}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def read_map_arrays(path: str | PathLike[str]) -> MapArrays:
    """Read a map written by `write_map_arrays`. Keys of the header that are not known here are passed over.

    Raises:
        ConfigError: no header of this format, or one of a newer version.
        InputError: no ``.npz`` file, or arrays that are missing, of other shapes or of more than 1 GiB, or values out
            of bounds; file and field are named.
    """
    path = Path(path)
    content = read_arrays(path, {"header": ("n",)}, max_bytes=MAX_HEADER)["header"]
    try:
        table = json.loads(content.tobytes()) if content.dtype == np.uint8 else None
    except (ValueError, RecursionError) as error:
        raise InputError("expected JSON", file=path, field="header") from error
    header = validated(_Header, table, file=path, above="header")
    shapes: dict[str, Shape] = {name: ("rows", "columns", *about.depth) for name, about in ARRAYS[header.kind].items()}
    arrays = read_arrays(path, shapes, max_bytes=MAX_BYTES)
    try:
        return MapArrays(kind=header.kind, arrays=arrays, cell_size=header.cell_size, origin=header.origin)
    except InputError as error:
        raise InputError(error.problem, file=path, field=error.field) from error


def picture_size(data: bytes) -> tuple[int, int] | None:
    """Width and height that the header of a picture declares; None where the data are no picture known here."""
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
    """A picture as OpenCV decodes it with an ``IMREAD_`` flag; None where it is none, cut short or damaged."""
    import cv2

    if data.startswith(PNG):  # on many threads at once: nothing of all the process is touched
        return _decoded(data, how) if _is_complete_png(data) else None
    log = cv2.utils.logging
    level = log.setLogLevel(log.LOG_LEVEL_SILENT)
    try:
        return _decoded(data, how)
    finally:
        log.setLogLevel(level)


def _decoded(data: bytes, how: int) -> NDArray[Any] | None:
    import cv2

    try:
        return cv2.imdecode(np.frombuffer(data, np.uint8), how) if data else None
    except cv2.error:
        return None


def _is_complete_png(data: bytes) -> bool:
    """Whether a PNG runs to its end chunk with every checksum right; the decoder would fill in what is missing."""
    at = len(PNG)
    while at + 12 <= len(data):
        end = at + 8 + int.from_bytes(data[at : at + 4])
        if end + 4 > len(data) or crc32(data[at + 4 : end]) != int.from_bytes(data[end : end + 4]):
            return False
        if data[at + 4 : at + 8] == b"IEND":
            return True
        at = end + 4
    return False


def decode_channels(data: bytes) -> NDArray[np.uint16] | None:
    """All channels of a picture as the file has them, with 65535 for the largest value of a channel.

    [H, W, C]: grey, or red, green and blue, or these and opacity; None where the data are no picture, cut short or
    damaged, or hold no whole numbers of up to 16 bits; nor are Netpbm files read whose largest value is neither 255 nor
    65535, since OpenCV does not scale by it.
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
