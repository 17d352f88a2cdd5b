"""Floor plans as map_server keeps them (an image and a YAML file) as worlds: the sides of occupied cells are walls."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache
from os import PathLike
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import Field

from moteslam.errors import ConfigError, InputError
from moteslam.robot.pictures import decode_picture
from moteslam.robot.section import Section
from moteslam.sim.layout_types import Segments

MAX_PIXELS = 64_000_000
MAX_BYTES = 256_000_000
MAX_EXTENT = 2000.0
"""[m]"""


class FloorPlan(Section):
    """A floor plan: the ``.yaml`` file of map_server, and what its unknown cells are.

    Attributes:
        file: seen from the scenario's own folder.
        unknown: ``free``: only occupied cells have walls; ``wall``: unknown ones too.
    """

    file: Annotated[str, Field(min_length=1, max_length=4096)]
    unknown: Literal["free", "wall"] = "free"


@dataclass(frozen=True, eq=False)
class OccupiedGrid:
    """Cells that are solid.

    Attributes:
        cells: bool [rows, cols], row 0 the smallest y.
        cell_size: [m].
        origin: x, y [m] and yaw [rad] of the outer corner of cell [0, 0].
    """

    cells: NDArray[np.bool_]
    cell_size: float
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def is_solid(self, points: ArrayLike) -> NDArray[np.bool_]:
        """Which of the points [n, 2] [m] lie in an occupied cell, shape [n]; nothing outside the image is."""
        x, y, yaw = self.origin
        away = np.asarray(points, np.float64).reshape(-1, 2) - (x, y)
        cos, sin = math.cos(yaw), math.sin(yaw)
        at = np.floor(away @ np.array([(cos, -sin), (sin, cos)]) / self.cell_size)
        rows, cols = self.cells.shape
        inside = (at >= 0).all(1) & (at[:, 0] < cols) & (at[:, 1] < rows)
        solid = np.zeros(len(at), bool)
        col, row = at[inside].astype(np.int64).T
        solid[inside] = self.cells[row, col]
        return solid

    def walls(self) -> Segments:
        """The sides between solid cells and others [m, 4] [m], each run of them in one piece."""
        lines = trace_sides(self.cells).reshape(-1, 2) * self.cell_size
        x, y, yaw = self.origin
        cos, sin = math.cos(yaw), math.sin(yaw)
        return np.asarray((lines @ np.array([(cos, sin), (-sin, cos)]) + (x, y)).reshape(-1, 4))


def trace_sides(cells: NDArray[np.bool_]) -> NDArray[np.float64]:
    """The sides between solid cells and others, outside included: [m, 4] x0, y0, x1, y1 in cells.

    Sides in line and touching are one segment, so long as the same hand is solid.
    """
    padded = np.pad(cells, 1)
    # +1 where a solid cell begins, -1 where one ends, looking along an axis
    level = padded[1:, 1:-1].astype(np.int8) - padded[:-1, 1:-1]  # [rows + 1, cols]: sides along x
    upright = (padded[1:-1, 1:].astype(np.int8) - padded[1:-1, :-1]).T  # [cols + 1, rows]: sides along y
    along_x, along_y = _runs(level), _runs(upright)
    flat = np.stack((along_x[:, 1], along_x[:, 0], along_x[:, 2], along_x[:, 0]), axis=-1)
    tall = np.stack((along_y[:, 0], along_y[:, 1], along_y[:, 0], along_y[:, 2]), axis=-1)
    return np.concatenate((flat, tall)).astype(np.float64)


def _runs(lines: NDArray[np.int8]) -> NDArray[np.int64]:
    """Runs of equal numbers other than 0 in each line: [k, 3] line, first, one past the last."""
    padded = np.pad(lines, ((0, 0), (1, 1)))
    change = padded[:, 1:] != padded[:, :-1]
    begins = np.argwhere(change & (padded[:, 1:] != 0))
    ends = np.argwhere(change & (padded[:, :-1] != 0))
    return np.column_stack((begins, ends[:, 1]))


def read_floor_plan(plan: FloorPlan) -> OccupiedGrid:
    """The solid cells of a floor plan.

    Raises:
        ConfigError: a file that is missing, not YAML or no image, a key that is missing or out of bounds, an image
            that is too large; file and key are named.
    """
    try:
        stamp = Path(plan.file).stat().st_mtime_ns
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        raise ConfigError(f"{said}, expected a map_server .yaml file", file=plan.file) from error
    return _read(plan, stamp)


@lru_cache(maxsize=8)
def _read(plan: FloorPlan, _stamp: int) -> OccupiedGrid:
    path = Path(plan.file)
    about = _about(path)
    resolution = _number(about, "resolution", path, low=1e-4, high=100.0)
    occupied = _number(about, "occupied_thresh", path, low=0.0, high=1.0, default=0.65)
    free = _number(about, "free_thresh", path, low=0.0, high=1.0, default=0.196)
    if free > occupied:
        raise ConfigError(f"{free:g}, expected at most occupied_thresh, {occupied:g}", file=path, field="free_thresh")
    image = _image(path.parent / str(about["image"]), path)
    if max(image.shape) * resolution > MAX_EXTENT:
        raise ConfigError(
            f"{image.shape[1]} x {image.shape[0]} cells of {resolution:g} m, expected at most {MAX_EXTENT:g} m a side",
            file=path,
            field="resolution",
        )
    belief = image / 255.0 if about.get("negate") in (1, True) else (255.0 - image) / 255.0
    solid = belief >= (free if plan.unknown == "wall" else occupied)
    if not solid.any():
        raise ConfigError("no occupied cell, expected walls", file=path, field="image")
    cells = np.ascontiguousarray(solid[::-1])
    cells.setflags(write=False)
    return OccupiedGrid(cells, resolution, _origin(about, path))


def _about(path: Path) -> dict[str, Any]:
    import yaml

    try:
        if path.stat().st_size > 100_000:
            raise ConfigError("over 100 kB, expected a map_server .yaml file", file=path)
        about = yaml.safe_load(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{error.strerror}, expected a map_server .yaml file", file=path) from error
    except (yaml.YAMLError, UnicodeDecodeError, RecursionError) as error:
        raise ConfigError(f"not YAML: {str(error).splitlines()[0]}", file=path) from error
    if not isinstance(about, dict):
        raise ConfigError("not a table, expected image, resolution and origin", file=path)
    for key in ("image", "resolution", "origin"):
        if key not in about:
            raise ConfigError("missing, expected in every map_server file", file=path, field=key)
    return about


def _number(
    about: dict[str, Any], key: str, path: Path, *, low: float, high: float, default: float | None = None
) -> float:
    value = about.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise ConfigError(f"{value!r}, expected a number from {low:g} to {high:g}", file=path, field=key)
    return float(value)


def _origin(about: dict[str, Any], path: Path) -> tuple[float, float, float]:
    origin = about["origin"]
    fits = isinstance(origin, list) and len(origin) == 3
    if not fits or not all(isinstance(v, int | float) and abs(v) <= 1e6 for v in origin):
        raise ConfigError(f"{origin!r}, expected three numbers: x, y [m] and yaw [rad]", file=path, field="origin")
    x, y, yaw = (float(value) for value in origin)
    return x, y, yaw


def _image(path: str | PathLike[str], asked_by: Path) -> NDArray[np.float64]:
    """The grey values [rows, cols] as the file has them, the largest y first."""
    import cv2

    path = Path(path)
    try:
        if path.stat().st_size > MAX_BYTES:
            raise ConfigError(f"over {MAX_BYTES} bytes, expected a floor plan", file=path)
        content = path.read_bytes()
    except (OSError, ValueError) as error:
        said = getattr(error, "strerror", None) or error
        raise ConfigError(f"{path.name}: {said}, expected a pgm or png image", file=asked_by, field="image") from error
    _refuse_outsized(content, path)
    image = decode_picture(content, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise ConfigError("not readable as an image, expected a whole pgm or png floor plan", file=path)
    return np.asarray(image, np.float64)


def _refuse_outsized(content: bytes, path: Path) -> None:
    """Look at the size that a PGM or PNG claims before anything is unpacked."""
    if content[:4] == b"\x89PNG" and len(content) >= 24:
        width, height = (int.from_bytes(content[at : at + 4], "big") for at in (16, 20))
    elif content[:2] in (b"P2", b"P5"):
        words = [line.split(b"#")[0] for line in content[2:400].splitlines()]
        numbers = b" ".join(words).split()
        try:
            width, height = int(numbers[0]), int(numbers[1])
        except (IndexError, ValueError):
            return  # the decoder will tell
    else:
        return
    if width * height > MAX_PIXELS:
        raise ConfigError(f"{width} x {height} pixels, expected at most {MAX_PIXELS} in all", file=path)


def grid_of(cells: ArrayLike, *, cell_size: float, origin: tuple[float, float] = (0.0, 0.0)) -> OccupiedGrid:
    """An `OccupiedGrid` from bools [rows, cols], row 0 the smallest y.

    Raises:
        InputError: not two-dimensional, or a cell size that is not positive.
    """
    found = np.asarray(cells, bool)
    if found.ndim != 2 or not (math.isfinite(cell_size) and cell_size > 0):
        raise InputError(f"{found.shape} cells of {cell_size} m, expected [rows, cols] of a positive size")
    return OccupiedGrid(found, float(cell_size), (*origin, 0.0))
