"""How nav2's map_server reads a cell, in plain Python: a pixel at a time, from the rules alone.

It sees channels of 16 bits, and opacity as one of them.
"""

from math import floor
from typing import NamedTuple

Pixel = tuple[int, ...]
"""The channels of a pixel: grey, or red, green and blue, or these and opacity."""


class Meaning(NamedTuple):
    """What the YAML file says of the greys."""

    mode: str
    negate: bool
    occupied: float
    free: float


def nav2_cell(pixel: Pixel, largest: int, says: Meaning) -> int:
    """The occupancy that nav2 publishes, -1 or 0 to 100.

    Args:
        pixel: numbers as the file has them.
        largest: that a channel may be.
        says: of the greys.
    """
    quanta = [(2 * 65535 * number + largest) // (2 * largest) for number in pixel]
    opaque = len(quanta) < 4 or quanta[3] == 65535
    averaged = quanta if says.mode == "trinary" else quanta[:3]
    shade = sum(averaged) / len(averaged) / 65535
    if says.mode == "raw":
        number = floor(shade * 255 + 0.5)
        return number if number <= 100 else -1
    occupancy = shade if says.negate else 1.0 - shade
    if says.mode == "scale" and not opaque:
        return -1
    if says.occupied < occupancy:
        return 100
    if occupancy < says.free:
        return 0
    if says.mode == "trinary" or says.occupied == says.free:
        return -1
    return round((occupancy - says.free) / (says.occupied - says.free) * 100.0)


def trinary_cell(pixel: Pixel, largest: int, says: Meaning) -> int:
    """Free (0), occupied (1) or unknown (-1): what is beyond the thresholds, of the mode raw as map_saver has it."""
    if says.mode == "raw":
        percent = nav2_cell(pixel, largest, says)
        if 0 <= percent <= round(100 * says.free):
            return 0
        return 1 if percent >= round(100 * says.occupied) else -1
    quanta = [(2 * 65535 * number + largest) // (2 * largest) for number in pixel]
    if says.mode == "scale" and len(quanta) == 4 and quanta[3] < 65535:
        return -1
    averaged = quanta if says.mode == "trinary" else quanta[:3]
    shade = sum(averaged) / len(averaged) / 65535
    occupancy = shade if says.negate else 1.0 - shade
    if occupancy > says.occupied:
        return 1
    return 0 if occupancy < says.free else -1
