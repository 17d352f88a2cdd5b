"""Maps as ROS's map_server keeps them: an image, and a YAML file that says where it lies and what its greys mean.

A raster has row 0 at the smallest y, an image at the largest: it is flipped here, at the file, and nowhere else.
"""

from __future__ import annotations

from collections.abc import Mapping
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.files import write_atomically
from moteslam.robot.pictures import decode_picture, encode_png, picture_size
from moteslam.robot.raster import Raster
from moteslam.robot.reading import read_bytes, read_text

FREE, OCCUPIED, UNKNOWN = 0, 1, -1
"""The values of a trinary map, int8."""

FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205
"""The greys that map_saver writes for them."""

OCCUPIED_THRESHOLD, FREE_THRESHOLD = 0.65, 0.196
"""map_server's own: at and above the one a cell is occupied, below the other free. A grey of 205 is just not free."""

MODES = ("trinary", "scale", "raw")

MAX_YAML_BYTES = 100_000
MAX_IMAGE_BYTES = 256_000_000
MAX_PIXELS = 64_000_000
MAX_EXTENT = 2000.0
"""Of a map's longer side [m]."""


def read_map(path: str | PathLike[str]) -> Raster:
    """Read a map as free, occupied and unknown cells.

    A grey of v stands for the probability (255 - v) / 255 of being occupied, with ``negate`` v / 255; in the mode
    ``raw`` v is that probability in percent, and unknown above 100. The modes ``trinary`` and ``scale`` differ in the
    cells between the two thresholds alone, which are unknown here.

    Args:
        path: of the ``.yaml``; the image that it names lies beside it.

    Returns:
        int8 values [H, W]: `FREE`, `OCCUPIED` or `UNKNOWN`.

    Raises:
        InputError: a file that is missing, not YAML or no image, a key that is missing or out of bounds, an image
            that is too large; file and key are named.
    """
    path = Path(path)
    about = _read_yaml(path)
    resolution = _number(about, "resolution", path, low=1e-4, high=100.0)
    occupied = _number(about, "occupied_thresh", path, low=0.0, high=1.0, default=OCCUPIED_THRESHOLD)
    free = _number(about, "free_thresh", path, low=0.0, high=1.0, default=FREE_THRESHOLD)
    if free > occupied:
        raise InputError(f"{free:g}, expected at most occupied_thresh, {occupied:g}", file=path, field="free_thresh")
    mode = _one_of(about, "mode", path, MODES)
    negate = bool(_one_of(about, "negate", path, (0, 1)))
    image = _read_image(path.parent / str(about["image"]), path)
    if max(image.shape) * resolution > MAX_EXTENT:
        raise InputError(
            f"{image.shape[1]} x {image.shape[0]} cells of {resolution:g} m, expected at most {MAX_EXTENT:g} m a side",
            file=path,
            field="resolution",
        )
    probability = image / 100.0 if mode == "raw" else image / 255.0 if negate else (255.0 - image) / 255.0
    values = np.where(probability >= occupied, OCCUPIED, np.where(probability >= free, UNKNOWN, FREE)).astype(np.int8)
    if mode == "raw":
        values[image > 100] = UNKNOWN
    values = np.ascontiguousarray(values[::-1])
    values.setflags(write=False)
    return Raster(values, resolution, _origin(about, path))


def write_map(path: str | PathLike[str], raster: Raster) -> None:
    """Write a trinary map: the image as PGM, and beside it the YAML file, as map_server and nav2 read them.

    Args:
        path: of the ``.pgm``; the ``.yaml`` has the same stem.
        raster: values [H, W] of `FREE`, `OCCUPIED` or `UNKNOWN`.

    Raises:
        OutputError: one of them cannot be written.
    """
    known = np.where(raster.values == OCCUPIED, OCCUPIED_GREY, FREE_GREY)
    image = np.where(raster.values == UNKNOWN, UNKNOWN_GREY, known).astype(np.uint8)[::-1]
    rows, columns = image.shape
    write_atomically(path, f"P5\n{columns} {rows}\n255\n".encode() + image.tobytes())
    thresholds = {"negate": 0, "occupied_thresh": OCCUPIED_THRESHOLD, "free_thresh": FREE_THRESHOLD}
    _write_yaml(Path(path), raster, {"mode": "trinary"}, thresholds)


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


def _write_yaml(image: Path, raster: Raster, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    import yaml

    place = {"resolution": float(raster.cell_size), "origin": [float(value) for value in raster.origin]}
    about = {"image": image.name, **before, **place, **after}
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True, width=float("inf"))
    write_atomically(image.with_suffix(".yaml"), text)


def _read_yaml(path: Path) -> dict[str, Any]:
    import yaml

    text = read_text(path, "a map_server .yaml file", limit=MAX_YAML_BYTES)
    try:
        about = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        problem = "nested too deep" if isinstance(error, RecursionError) else str(error).splitlines()[0]
        raise InputError(f"not YAML: {problem.partition(';')[0]}", file=path) from error
    if not isinstance(about, dict):
        raise InputError("not a table, expected image, resolution and origin", file=path)
    for key in ("image", "resolution", "origin"):
        if key not in about:
            raise InputError("missing, expected in every map_server file", file=path, field=key)
    return about


def _number(
    about: dict[str, Any], key: str, path: Path, *, low: float, high: float, default: float | None = None
) -> float:
    value = about.get(key, default)
    if isinstance(value, bool) or not isinstance(value, int | float) or not low <= value <= high:
        raise InputError(f"{value!r}, expected a number from {low:g} to {high:g}", file=path, field=key)
    return float(value)


def _one_of(about: dict[str, Any], key: str, path: Path, choices: tuple[Any, ...]) -> Any:
    """The value of a key, the first of the choices where it is left out."""
    value = about.get(key, choices[0])
    if value not in choices:
        raise InputError(f"{value!r}, expected {', '.join(map(str, choices))}", file=path, field=key)
    return value


def _origin(about: dict[str, Any], path: Path) -> tuple[float, float, float]:
    origin = about["origin"]
    fits = isinstance(origin, list) and len(origin) == 3
    if not fits or not all(isinstance(value, int | float) and abs(value) <= 1e6 for value in origin):
        raise InputError(f"{origin!r}, expected three numbers: x, y [m] and yaw [rad]", file=path, field="origin")
    x, y, yaw = (float(value) for value in origin)
    return x, y, yaw


def _read_image(path: Path, yaml_file: Path) -> NDArray[np.float64]:
    """The grey values [rows, columns] as the file has them, the largest y first."""
    import cv2

    try:
        content = read_bytes(path, "a pgm or png image", limit=MAX_IMAGE_BYTES)
    except InputError as error:
        raise InputError(f"{path.name}: {error.problem}", file=yaml_file, field="image") from error
    size = picture_size(content)
    if size is not None and size[0] * size[1] > MAX_PIXELS:
        raise InputError(f"{size[0]} x {size[1]} pixels, expected at most {MAX_PIXELS} in all", file=path)
    image = decode_picture(content, cv2.IMREAD_GRAYSCALE)
    if image is None:
        raise InputError("not readable as an image, expected a complete pgm or png map", file=path)
    return np.asarray(image, np.float64)
