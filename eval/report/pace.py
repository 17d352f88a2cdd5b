"""The pace of a film: which moment of a run each of its frames shows."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError

MAX_FPS = 50.0
"""Frames a second. Browsers slow GIFs down that have more."""
MAX_SPEED = 10000.0
USUAL_LENGTH = 15.0
"""A film is at most this long where nobody asks for a speed [s]."""
SPEEDS = tuple(step * 10.0**power for power in range(4) for step in (1, 2, 5))
"""The speeds to choose from then."""
MAX_FRAMES = 2000


@dataclass(frozen=True)
class Pace:
    """How fast a film goes.

    Attributes:
        fps: frames a second.
        speed: seconds of the run in a second of the film: 1 is real time.
    """

    fps: float
    speed: float

    def __post_init__(self) -> None:
        if not 1 <= self.fps <= MAX_FPS:
            raise ConfigError(f"{self.fps:g}, expected 1 to {MAX_FPS:g} frames a second", field="fps")
        if not 0.1 <= self.speed <= MAX_SPEED:
            raise ConfigError(f"{self.speed:g}, expected 0.1 to {MAX_SPEED:g} times real time", field="speed")

    @classmethod
    def of(cls, duration: float, *, fps: float = 15.0, speed: float | None = None) -> Pace:
        """The pace of a film of a run.

        Args:
            duration: of the run [s].
            fps: frames a second.
            speed: times real time; None chooses one with which the film takes at most ``USUAL_LENGTH``.

        Raises:
            ConfigError: a value out of bounds, or more than ``MAX_FRAMES`` frames.
        """
        if speed is None:
            speed = next((speed for speed in SPEEDS if duration / speed <= USUAL_LENGTH), SPEEDS[-1])
        pace = cls(fps, speed)
        if duration * fps / speed > MAX_FRAMES:
            found = f"{duration:.0f} s at {fps:g} frames a second and {speed:g} times real time"
            raise ConfigError(f"{found}, expected a speed for at most {MAX_FRAMES} frames", field="speed")
        return pace

    def moments(self, stamps: NDArray[np.float64]) -> NDArray[np.int64]:
        """For each frame [k] the index of the last scan before it; the last frame shows the last scan.

        Args:
            stamps: of the scans [n] [s].
        """
        times = np.arange(stamps[0], stamps[-1], self.speed / self.fps)
        return np.append(np.searchsorted(stamps, times, side="right") - 1, len(stamps) - 1)

    def __str__(self) -> str:
        return f"{self.speed:g} × real time, {self.fps:g} frames/s"
