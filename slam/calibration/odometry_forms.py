"""The forms in which odometry poses are read: of their headings, y and the direction of the path."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.slam.inputs.odometry_path import OdometryPath

Array = NDArray[np.float64]

FORMS = ("stated", "turns", "y", "path")
"""How odometry poses are read: as stated, with their headings or their y negated, headings along the path."""
MOVES = 0.05
"""The direction of a path is taken over this distance [m]."""
QUARTER, AHEAD = 0.15, 0.8
"""A mount is a quarter turn off within the first [rad]; a path goes one way as seen by its headings where this share of
it does."""


def in_form(path: OdometryPath, form: str, quarter: float = 0.0) -> OdometryPath:
    """A path read in one of the `FORMS`, with an angle [rad] added to its headings."""
    x, y, heading = path.poses.T
    if form == "turns":
        heading = -heading
    elif form == "y":
        y = -y
    elif form == "path":
        heading = _along(path.poses)
    return OdometryPath(path.stamps, np.stack((x, y, heading + quarter), axis=1))


def quarter_turn(poses: Array, aside: float) -> float:
    """The quarter turn by which headings of a path [n, 3] are off, 0 if the lidar may be: it is aside by an angle."""
    quarter = float(np.copysign(np.pi / 2, aside))
    steps = np.diff(poses[:, 0] + 1j * poses[:, 1]) * np.exp(-1j * poses[:-1, 2])
    way, total = complex(steps.sum()), float(np.abs(steps).sum())
    one_way = abs(way) > AHEAD * total and abs(float(se2.wrap(np.angle(way) - quarter))) < np.pi / 4
    return quarter if abs(aside - quarter) < QUARTER and one_way else 0.0


def _along(poses: Array) -> Array:
    """The direction of a path at its poses [n], unwrapped [rad]."""
    way = np.concatenate(([0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))))
    _, first = np.unique(np.floor(way / MOVES), return_index=True)
    if len(first) < 3:
        return np.zeros(len(poses))
    step = np.diff(poses[first, :2], axis=0)
    middle = (first[1:] + first[:-1]) / 2
    return np.interp(np.arange(len(poses)), middle, np.unwrap(np.arctan2(step[:, 1], step[:, 0])))
