"""What no robot does and no lidar has: readings beyond it are glitches or other units."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.platform import too_wide

MAX_RATE = 100.0
"""No robot turns faster [rad/s]: 16 turns a second; common gyros end at 35 rad/s, the largest range sold is 70."""

MAX_SPEED = 100.0
"""No wheeled robot drives faster [m/s]."""

MAX_PLACE = 1e7
"""No robot is farther from where it began [m], nor has turned more in all [rad]: a quarter of the globe."""

SLACK = 1.0
"""Travel [m] that a reading may give beyond that, for stamps jitter: a late one leaves the next no time."""


def check_fan(beams: int, increment: float, *, file: Path | None = None, field: str) -> None:
    """Refuse a fan of more than a full turn; first and last beam may be the same direction.

    Args:
        beams: how many.
        increment: between them [rad].
        file, field: for the message.

    Raises:
        InputError: the beams go round more than once.
    """
    if (problem := too_wide(beams, increment)) is not None:
        raise InputError(problem, file=file, field=field)


def check_figures(beams: int, increment: float, range_min: float, range_max: float, *, file: Path) -> None:
    """Refuse a caller's figures of a lidar, a ``platform.toml``'s, that do not fit the recording's own.

    Args:
        beams: of the recording.
        increment: between beams [rad]; range_min, range_max: limits [m], some of them the caller's.
        file: of the recording.

    Raises:
        InputError: beams that go round more than once, or limits the wrong way round.
    """
    check_fan(beams, increment, file=file, field="platform.lidar.angle_increment")
    if range_min >= range_max:
        raise InputError(
            f"{range_min:g} m, expected less than the {range_max:g} m that are its range_max",
            file=file,
            field="platform.lidar.range_min",
        )


def plausible_rates(angular_velocity: NDArray[np.floating]) -> NDArray[np.bool_]:
    """Which readings [n] of a gyro [n, 3] [rad/s] can be a robot's: none beyond 100 rad/s about any axis."""
    return np.asarray((np.abs(angular_velocity) <= MAX_RATE).all(axis=1))


def plausible_counts(
    stamps: NDArray[np.float64], counts: NDArray[np.integer | np.floating], metres_per_count: float
) -> NDArray[np.bool_]:
    """Which readings [n] of wheel counters [n, 4] can be a robot's: no wheel beyond 100 m/s (and 1 m for jitter)."""
    elapsed = np.diff(stamps, prepend=stamps[:1])
    travel = np.abs(counts.astype(np.float64)).max(axis=1) * metres_per_count
    return np.asarray(travel <= SLACK + MAX_SPEED * elapsed)
