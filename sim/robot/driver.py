"""What a driver is: it asks for a speed and turn rate, given where the robot truly is.

The driver of the real robot saw where it was, and so does a simulated one. SLAM is given the sensors' readings alone.
"""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray


class Driver(Protocol):
    """Chooses what to do next.

    Attributes:
        looks: whether it slows down for people and doors, and gives up where it does not get on.
        at: the index of where it is on its path; set where it is to go on from another place.
    """

    looks: bool
    at: int

    @property
    def path(self) -> NDArray[np.float64] | None:
        """The points [n, 2] that it drives along [m]; None where it follows no path."""
        ...

    def command(self, time: float, x: float, y: float, theta: float) -> tuple[float, float] | None:
        """The speed [m/s] and turn rate [rad/s] to ask for at a time [s since the rest ended] and true pose.

        None when the driver has arrived.
        """
        ...

    @property
    def done(self) -> float:
        """The share of the path or time that lies behind."""
        ...
