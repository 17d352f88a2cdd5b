"""What a map_server map says: its YAML file, and what the greys of its image mean as occupancies.

Occupancies are -1 (unknown) or 0 to 100 %, as in nav_msgs/OccupancyGrid. Source: how ROS 1's map_server (Noetic) and
nav2's (Foxy to Jazzy) read and save maps. They agree on what is trinary, but for the last bit of a probability:

    ==================  ==========================================  ========================================
                        nav2                                        ros1
    ==================  ==========================================  ========================================
    brightness          of 16 bits                                  of the upper 8 bits
    scale, in between   the nearest of 0 to 100                     1 to 99, rounded down
    scale, unknown      every pixel that is not opaque              between the thresholds, opacity 0
    raw                 the brightness as it is, negate or not      negated, rounded down
    ==================  ==========================================  ========================================
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass
from math import isfinite
from pathlib import Path, PureWindowsPath
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import read_yaml
from moteslam.robot.pictures import FULL

Percent = NDArray[np.int8]
Rules = Literal["nav2", "ros1"]
Mode = Literal["trinary", "scale", "raw"]
RULES: tuple[Rules, ...] = get_args(Rules)
MODES: tuple[Mode, ...] = get_args(Mode)

UNKNOWN_PERCENT, FREE_PERCENT, OCCUPIED_PERCENT = -1, 0, 100
"""Occupancies."""
FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205
"""The greys that map_saver writes for them in the mode trinary."""
RAW_UNKNOWN, SCALE_UNKNOWN = 255, 128
"""The greys that it writes for what is unknown in the others; transparent in the mode scale."""
MAX_YAML_BYTES = 100_000
MAX_PLACE = 1e6
"""No map lies farther from its frame's origin [m]."""
_BAND = 1 << 20
"""Pixels that are worked on at once."""


@dataclass(frozen=True)
class MapFile:
    """What the YAML file says.

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
        InputError: it cannot be read, is not YAML, lacks a key other than ``mode`` or has one that is out of bounds, or
            names an image outside of its folder; file and key are named.
    """
    about = read_yaml(path, "a map_server .yaml file", limit=MAX_YAML_BYTES)
    if not isinstance(about, dict):
        raise InputError("not a table, expected image, resolution and origin", file=path)

    def number(key: str, value: object, low: float, high: float, expected: str = "") -> float:
        found = _as_number(value)
        if found is None or not low <= found <= high:
            expected = expected or f"a number from {low:g} to {high:g}"
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
    three = "three numbers: x, y [m] and yaw [rad]"
    x, y, yaw = [number("origin", value, -MAX_PLACE, MAX_PLACE, three) for value in place]
    resolution = number("resolution", about["resolution"], 1e-4, 100)
    return MapFile(_image(about["image"], path), resolution, (x, y, yaw), mode, bool(negate), occupied, free)


def _as_number(value: object) -> float | None:
    """A finite number; also one that is text to YAML 1.1 and a number to the programs that write it, as ``5e-2``."""
    try:
        number = float(value) if isinstance(value, int | float | str) and not isinstance(value, bool) else float("nan")
    except (ValueError, OverflowError):
        return None
    return number if isfinite(number) else None


def _image(name: object, path: Path) -> Path:
    """The image's path, relative to the YAML file's folder or absolute, and within that folder.

    Of a path of another computer or folder its name is looked for beside the YAML file, with a warning.
    """
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


def occupancies(pixels: NDArray[np.uint16], about: MapFile, rules: Rules = "nav2", *, between: bool = True) -> Percent:
    """The occupancies [H, W] that map_server makes of an image.

    Args:
        pixels: [H, W, C]: grey, or red, green and blue, or these and opacity, of 65535.
        about: mode, thresholds and which end is white.
        rules: whose.
        between: give those between the thresholds as the mode scale does; else they are unknown there, too.
    """
    flat, found = pixels.reshape(-1, pixels.shape[2]), np.empty(pixels.shape[0] * pixels.shape[1], np.int8)
    for start in range(0, len(flat), _BAND):
        found[start : start + _BAND] = _of(flat[start : start + _BAND], about, rules == "ros1", between)
    return found.reshape(pixels.shape[:2])


def _of(pixels: NDArray[np.uint16], about: MapFile, ros1: bool, between: bool) -> Percent:
    """The occupancies [n] of pixels [n, C]."""
    values, full = (pixels >> 8, 255) if ros1 else (pixels, FULL)
    colours = values if about.mode == "trinary" else values[:, :3]
    shade = colours.sum(axis=1, dtype=np.float64) / colours.shape[1]
    if ros1 and about.negate:
        shade = full - shade
    if about.mode == "raw":
        whole = np.floor(shade if ros1 else 255 * (shade / full) + 0.5)
        return np.where(whole <= OCCUPIED_PERCENT, whole, UNKNOWN_PERCENT).astype(np.int8)
    probability = (full - shade) / full if ros1 else shade / full if about.negate else 1.0 - shade / full
    inner = np.full(len(pixels), float(UNKNOWN_PERCENT))
    width = about.occupied - about.free
    if about.mode == "scale" and between and width > 0:
        ratio = (probability - about.free) / width
        inner = np.floor(1 + 98 * ratio) if ros1 else np.rint(100.0 * ratio)
        if ros1 and pixels.shape[1] > 1:  # its last channel stands for opacity, also where it is blue
            inner[values[:, -1] == 0] = UNKNOWN_PERCENT
    found = np.where(probability < about.free, FREE_PERCENT, inner)
    found[probability > about.occupied] = OCCUPIED_PERCENT
    if about.mode == "scale" and pixels.shape[1] == 4 and not ros1:
        found[pixels[:, 3] < FULL] = UNKNOWN_PERCENT
    return found.astype(np.int8)


def warn_of_thresholds(path: Path, about: MapFile, pixels: NDArray[np.uint16]) -> None:
    """Warn where all greys are map_saver's, and the thresholds make something else of that of unknown cells.

    map_saver wrote ``free_thresh: 0.25`` for years, by which its grey of them, 205, is free.
    """
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
    read = int(occupancies(one, about, between=False)[0, 0])
    if read != UNKNOWN_PERCENT:
        what = f"grey {unknown}, which map_saver writes for unknown, is read as {'occupied' if read else 'free'}"
        why = f"by free_thresh {about.free:g}, occupied_thresh {about.occupied:g} and negate {int(about.negate)}"
        cells = f"{counts[UNKNOWN_GREY]} of {counts.sum()} cells count as known, so map_known is too high"
        mend = "" if read else ": free_thresh: 0.196 would leave them unknown"
        warnings.warn(MoteslamWarning(f"{path}: {what} {why}; {cells}{mend}"), stacklevel=4)


def saved(percent: Percent, occupied: float, free: float) -> Percent:
    """Occupancies [...] as map_saver decides them by two thresholds: free, occupied or unknown."""
    beyond = np.where(percent >= round(100 * occupied), OCCUPIED_PERCENT, UNKNOWN_PERCENT)
    known = np.where(percent <= round(100 * free), FREE_PERCENT, beyond)
    return np.where(percent >= 0, known, UNKNOWN_PERCENT).astype(np.int8)


def pixels_of(percent: Percent, mode: Mode, *, occupied: float, free: float, negate: bool) -> NDArray[np.uint8]:
    """The pixels that map_saver writes for occupancies.

    Args:
        percent: [H, W] of -1 or 0 to 100.
        mode: of the map.
        occupied, free: thresholds, which the mode trinary goes by.
        negate: white is occupied.

    Returns:
        [H, W] grey; in the mode scale, where something is unknown, [H, W, 4] red, green, blue and opacity.

    Raises:
        InputError: ``negate`` in the mode raw, which nav2 reads without and ROS 1 with it.
    """
    known = percent >= 0
    if mode == "raw":
        if negate:
            raise InputError("true with the mode raw, expected false: map_servers differ in it", field="negate")
        return np.where(known, percent, RAW_UNKNOWN).astype(np.uint8)
    if mode == "trinary":
        decided = saved(percent, occupied, free)
        beyond = np.where(decided == OCCUPIED_PERCENT, OCCUPIED_GREY, UNKNOWN_GREY)
        grey = np.where(decided == FREE_PERCENT, FREE_GREY, beyond)
        return (255 - grey if negate else grey).astype(np.uint8)
    bright = percent if negate else 100 - percent.astype(np.int16)
    grey = np.where(known, np.rint(bright / 100 * 255), SCALE_UNKNOWN).astype(np.uint8)
    return grey if known.all() else np.dstack((grey, grey, grey, np.where(known, 255, 0).astype(np.uint8)))


def map_file_text(image: Path, place: dict[str, Any], before: dict[str, Any], after: dict[str, Any]) -> str:
    """The text of a YAML file: image and place, with more keys before and after the place."""
    import yaml

    about = {"image": image.name, **before, **place, **after}
    return yaml.safe_dump(about, sort_keys=False, default_flow_style=None, allow_unicode=True, width=float("inf"))
