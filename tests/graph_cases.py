"""Key scans, nodes and loops for tests of the back end."""

import numpy as np
from loop_candidates import candidate
from numpy.typing import ArrayLike, NDArray

from moteslam.slam.backend.graph.loop_search import Loop
from moteslam.slam.backend.protocol import KeyScan

CORRIDOR = np.array([[x, y] for x in np.arange(-3, 3, 0.1) for y in (-1.0, 1.0)], np.float32)
WALL = np.array([[1.0, y] for y in np.arange(-1, 1, 0.1)], np.float32)


def key_scan(
    index: int,
    odometry: ArrayLike,
    points: NDArray[np.float32] = CORRIDOR,
    *,
    motion: ArrayLike | None = None,
    pose: ArrayLike = (0.0, 0.0, 0.0),
) -> KeyScan:
    """The key scan of an update, a tenth of a second each; by the filter it moved as by the odometry unless given."""
    step, place = np.array(odometry, float), np.array(pose, float)
    moved = step if motion is None else np.array(motion, float)
    return KeyScan(index, 0.1 * index, points, np.zeros(2), place, step, measured=True, motion=moved)


def loop(first: int, second: int, found: ArrayLike, predicted: ArrayLike) -> Loop:
    """An accepted one, good to a centimetre."""
    return Loop(candidate(first, second, found=found, predicted=predicted), np.diag((1e4, 1e4, 1e5)))
