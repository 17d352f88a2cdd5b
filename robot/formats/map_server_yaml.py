"""The YAML file of a map_server map: where its image is and lies, and what its greys mean."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from pathlib import Path, PureWindowsPath
from typing import Any, Literal, get_args

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import write_atomically
from moteslam.robot.raster import Raster
from moteslam.robot.yaml_table import read_yaml

Mode = Literal["trinary", "scale", "raw"]
MODES: tuple[Mode, ...] = get_args(Mode)

MAX_YAML_BYTES = 100_000
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""
REQUIRED = ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")
"""Keys that map_server and nav2 refuse to do without; ``mode`` they take for trinary."""


@dataclass(frozen=True)
class MapFile:
    """What the file says.

    Attributes:
        image: path of the image.
        resolution: side of a cell [m].
        origin: x, y [m] and yaw [rad] of the lower left corner of the image.
        mode: how greys become occupancies.
        negate: whether white is occupied, not black.
        occupied, free: thresholds of the probability of being occupied.
    """

    image: Path
    resolution: float
    origin: tuple[float, float, float]
    mode: Mode
    negate: bool
    occupied: float
    free: float


def read_map_file(path: Path) -> MapFile:
    """Read the YAML file of a map.

    Raises:
        InputError: it cannot be read, is not YAML, lacks a key or has one that is out of bounds, or names an image
            outside of its folder; file and key are named.
    """
    about = _table(path)
    occupied = _number(about, "occupied_thresh", path, low=0.0, high=1.0)
    free = _number(about, "free_thresh", path, low=0.0, high=1.0)
    if free > occupied:
        raise InputError(f"{free:g}, expected at most occupied_thresh, {occupied:g}", file=path, field="free_thresh")
    if (mode := about.get("mode", MODES[0])) not in MODES:
        raise InputError(f"{mode!r}, expected {', '.join(MODES)}", file=path, field="mode")
    if not isinstance(negate := about["negate"], int):
        raise InputError(f"{negate!r}, expected 0 or 1", file=path, field="negate")
    return MapFile(
        image=_image(about["image"], path),
        resolution=_number(about, "resolution", path, low=1e-4, high=100.0),
        origin=_origin(about, path),
        mode=mode,
        negate=bool(negate),
        occupied=occupied,
        free=free,
    )


def write_map_file(image: Path, raster: Raster, before: Mapping[str, Any], after: Mapping[str, Any]) -> None:
    """Write the YAML file beside an image, under its name: where a raster lies, with more keys before and after.

    Raises:
        OutputError: it cannot be written.
    """
    import yaml

    place = {"resolution": float(raster.cell_size), "origin": [float(value) for value in raster.origin]}
    about = {"image": image.name, **before, **place, **after}
    text = yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True, width=float("inf"))
    write_atomically(image.with_suffix(".yaml"), text)


def _table(path: Path) -> dict[str, Any]:
    about = read_yaml(path, "a map_server .yaml file", limit=MAX_YAML_BYTES)
    if not isinstance(about, dict):
        raise InputError("not a table, expected image, resolution and origin", file=path)
    for key in REQUIRED:
        if key not in about:
            raise InputError("missing, expected in every map_server file", file=path, field=key)
    return about


def _image(name: object, path: Path) -> Path:
    """The image's path, relative to the YAML file's folder or absolute, and within that folder.

    Of a path of another computer or folder its name is looked for beside the YAML file, with a warning.
    """
    if not isinstance(name, str) or not name:
        raise InputError(f"{name!r}, expected the name of a pgm or png image", file=path, field="image")
    image = path.parent / name
    try:
        inside = image.resolve().is_relative_to(path.parent.resolve())
    except (OSError, ValueError, RuntimeError) as error:  # a null byte in the name, links in a circle
        raise InputError(f"{name!r}, expected a pgm or png image", file=path, field="image") from error
    there = PureWindowsPath(name)  # knows both slashes
    beside = path.parent / there.name
    if there.root and not (inside and image.is_file()) and there.name and beside.is_file() and not beside.is_symlink():
        text = f"{path}: image: {name[:200]!r} is not in its folder, {beside.name!r} beside it is taken"
        warnings.warn(MoteslamWarning(text), stacklevel=2)
        return beside
    if not inside:
        expected = "expected an image in the folder of this file, or below"
        raise InputError(f"{name!r} lies elsewhere, {expected}", file=path, field="image")
    return image


def _number(about: dict[str, Any], key: str, path: Path, *, low: float, high: float) -> float:
    number = _as_number(about[key])
    if number is None or not low <= number <= high:
        raise InputError(f"{about[key]!r}, expected a number from {low:g} to {high:g}", file=path, field=key)
    return number


def _as_number(value: object) -> float | None:
    """A finite number; also one that is text to YAML 1.1 and a number to the programs that write it, as ``5e-2``."""
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        return None
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return None
    return number if isfinite(number) else None


def _origin(about: dict[str, Any], path: Path) -> tuple[float, float, float]:
    origin = about["origin"]
    numbers = [_as_number(value) for value in origin] if isinstance(origin, list) and len(origin) == 3 else [None]
    x, y, yaw = (value for value in (*numbers, None, None)[:3])
    if x is None or y is None or yaw is None or max(abs(x), abs(y), abs(yaw)) > MAX_PLACE:
        raise InputError(f"{origin!r}, expected three numbers: x, y [m] and yaw [rad]", file=path, field="origin")
    return x, y, yaw
