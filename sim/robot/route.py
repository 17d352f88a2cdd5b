"""A route: waypoints that the robot drives past in order."""

from __future__ import annotations

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field, model_validator

from moteslam.robot.tables import Number, Section, Truth
from moteslam.sim.world.geometry import Point


class Route(Section):
    """Waypoints that are driven past in order, in straight legs with rounded corners.

    Attributes:
        waypoints: [m]; the robot starts on the first, heading for the second.
        closed: whether the last leads back to the first.
        laps: how many times round a closed route, parts of a lap included.
    """

    waypoints: Annotated[tuple[Point, ...], Field(min_length=2, max_length=10_000)]
    closed: Truth = False
    laps: Annotated[Number, Field(gt=0, le=100)] = 1.0

    @model_validator(mode="after")
    def _makes_sense(self) -> Route:
        if self.laps != 1.0 and not self.closed:
            raise ValueError("laps of an open route, expected closed = true or no laps")
        if (np.hypot(*np.diff(self.corners, axis=0).T) == 0).any():
            raise ValueError("two successive waypoints are the same, expected them apart")
        return self

    @property
    def corners(self) -> NDArray[np.float64]:
        """The corners [k, 2] of one lap, the first repeated at the end if it is closed."""
        points = (*self.waypoints, self.waypoints[0]) if self.closed else self.waypoints
        return np.asarray(points, np.float64)

    @property
    def start_pose(self) -> NDArray[np.float64]:
        """X [m], y [m], theta [rad]: on the first waypoint, heading for the second."""
        first, second = self.corners[:2]
        return np.array((*first, np.arctan2(*(second - first)[::-1])))

    def path(self) -> NDArray[np.float64]:
        """The corners [k, 2] of all the laps, the last lap cut where it ends."""
        lap = self.corners
        if not self.closed:
            return lap
        complete = int(self.laps)
        corners = np.concatenate([lap[:-1]] * complete + [lap])
        length = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(corners, axis=0).T))))
        end = self.laps * length[len(lap) - 1]
        kept = length < end - 1e-9
        last = [np.interp(end, length, corners[:, axis]) for axis in (0, 1)]
        return np.concatenate((corners[kept], [last]))
