"""What the pixels of a map_server map mean: occupancies of -1 (unknown) or 0 to 100 %, as in nav_msgs/OccupancyGrid.

Source: how ROS 1's map_server (Noetic) and nav2's (Foxy to Jazzy) read and save maps. They agree on what is trinary,
but for the last bit of a probability, and differ in the rest:

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

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.map_server_yaml import MapFile, Mode
from moteslam.robot.netpbm import FULL

Pixels = NDArray[np.uint16]
"""[n, C]: grey, or red, green and blue, or these and opacity, of 65535."""
Percent = NDArray[np.int8]
Rules = Literal["nav2", "ros1"]

UNKNOWN_PERCENT, FREE_PERCENT, OCCUPIED_PERCENT = -1, 0, 100
"""Occupancies."""
FREE_GREY, OCCUPIED_GREY, UNKNOWN_GREY = 254, 0, 205
"""The greys that map_saver writes for them in the mode trinary."""
RAW_UNKNOWN, SCALE_UNKNOWN = 255, 128
"""The greys that it writes for what is unknown in the others; transparent in the mode scale."""

_BAND = 1 << 20
"""Pixels that are worked on at once."""


def occupancies(pixels: NDArray[np.uint16], about: MapFile, rules: Rules = "nav2", *, between: bool = True) -> Percent:
    """The occupancies [H, W] that map_server makes of an image.

    Args:
        pixels: [H, W, C] of the image, see ``Pixels``.
        about: mode, thresholds and which end is white.
        rules: whose.
        between: give those between the thresholds as the mode scale does; else they are unknown there, too.
    """
    rows, columns, channels = pixels.shape
    flat, found = pixels.reshape(-1, channels), np.empty(rows * columns, np.int8)
    for start in range(0, len(flat), _BAND):
        found[start : start + _BAND] = _RULES[rules](flat[start : start + _BAND], about, between)
    return found.reshape(rows, columns)


def saved(percent: Percent, occupied: float, free: float) -> Percent:
    """Occupancies [...] as map_saver decides them by two thresholds: free, occupied or unknown."""
    known, is_free = percent >= 0, percent <= round(100 * free)
    beyond = np.where(percent >= round(100 * occupied), OCCUPIED_PERCENT, UNKNOWN_PERCENT)
    return np.where(known, np.where(is_free, FREE_PERCENT, beyond), UNKNOWN_PERCENT).astype(np.int8)


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


def _by_nav2(pixels: Pixels, about: MapFile, between: bool) -> Percent:
    colours = pixels if about.mode == "trinary" else pixels[:, :3]
    shade = colours.sum(axis=1, dtype=np.float64) / colours.shape[1] / FULL
    if about.mode == "raw":
        return _whole(np.floor(255 * shade + 0.5))
    probability = shade if about.negate else 1.0 - shade
    scale = about.mode == "scale"
    inner = 100.0 * _ratio(probability, about) if scale and between else np.full(len(pixels), np.nan)
    found = _thresholded(probability, about, np.rint(inner))
    if scale and pixels.shape[1] == 4:
        found[pixels[:, 3] < FULL] = UNKNOWN_PERCENT
    return found


def _by_ros1(pixels: Pixels, about: MapFile, between: bool) -> Percent:
    values = pixels >> 8
    colours = values if about.mode == "trinary" else values[:, :3]
    grey = colours.sum(axis=1, dtype=np.float64) / colours.shape[1]
    if about.negate:
        grey = 255 - grey
    if about.mode == "raw":
        return _whole(np.floor(grey))
    probability = (255 - grey) / 255.0
    if about.mode == "trinary" or not between:
        inner = np.full(len(pixels), np.nan)
    else:
        inner = np.floor(1 + 98 * _ratio(probability, about))
        if pixels.shape[1] > 1:  # its last channel stands for opacity, also where it is blue
            inner[values[:, -1] == 0] = np.nan
    return _thresholded(probability, about, inner)


_RULES: dict[str, Callable[[Pixels, MapFile, bool], Percent]] = {"nav2": _by_nav2, "ros1": _by_ros1}
RULES = tuple(_RULES)


def _ratio(probability: NDArray[np.float64], about: MapFile) -> NDArray[np.float64]:
    """Where probabilities lie between the thresholds, 0 to 1 from one to the other; NaN where these are the same."""
    width = about.occupied - about.free
    return (probability - about.free) / (width if width > 0 else np.nan)


def _thresholded(probability: NDArray[np.float64], about: MapFile, inner: NDArray[np.float64]) -> Percent:
    """Occupied above the one threshold, free below the other; in between ``inner``, unknown where that is NaN."""
    inner = np.where(np.isnan(inner), UNKNOWN_PERCENT, inner)
    found = np.where(probability < about.free, FREE_PERCENT, inner)
    found[probability > about.occupied] = OCCUPIED_PERCENT
    return found.astype(np.int8)


def _whole(values: NDArray[np.float64]) -> Percent:
    """Whole numbers of at most 100 as occupancies, all others as unknown."""
    return np.where(values <= OCCUPIED_PERCENT, values, UNKNOWN_PERCENT).astype(np.int8)
