"""The fan of a lidar's beams: how far it goes round."""

from __future__ import annotations

import math


def field_of_view(beams: int, increment: float) -> float:
    """The angle from the first beam to the last [rad].

    Args:
        beams: how many.
        increment: between them [rad], of either sign.
    """
    return (beams - 1) * abs(increment)


def too_wide(beams: int, increment: float) -> str | None:
    """What is wrong with a fan that goes round more than once, else None; arguments as of ``field_of_view``.

    First and last beam may be the same direction.
    """
    angle = field_of_view(beams, increment)
    if angle <= 2 * math.pi + abs(increment) / 2:
        return None
    return f"{beams} beams {increment:.6g} rad apart are {angle / (2 * math.pi):.2f} turns, expected one at most"
