"""Poses between known ones, along a motion that is known to be off by little."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2

Array = NDArray[np.float64]


def between_known(path: Array, known: NDArray[np.intp], motion: Array) -> Array:
    """The poses [n, 3] of all n places along a motion, where those of some are known.

    Motion on from the place before and back from the place after do not quite meet; the misfit is spread evenly over
    the places between.

    Args:
        path: [u, 3] poses of the known places.
        known: [u] which of the n places they are, rising.
        motion: [n, 3] poses of all places, as the motion has them, in a frame of its own.
    """
    places = np.arange(len(motion))
    before = np.clip(np.searchsorted(known, places, side="right") - 1, 0, len(known) - 1)
    after = np.minimum(before + 1, len(known) - 1)
    forward = se2.compose(path[before], se2.between(motion[known[before]], motion))
    backward = se2.compose(path[after], se2.between(motion[known[after]], motion))
    span = known[after] - known[before]
    share = np.where(span > 0, (places - known[before]) / np.maximum(span, 1), 0.0)[:, None]
    misfit = backward - forward
    misfit[:, 2] = se2.wrap(misfit[:, 2])
    poses = forward + share * misfit
    poses[:, 2] = se2.wrap(poses[:, 2])
    return np.asarray(poses)
