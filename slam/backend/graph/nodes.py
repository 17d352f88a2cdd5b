"""The nodes of the graph: key scans some distance or turn apart."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.protocol import KeyScan
from moteslam.slam.inputs.lapses import CLOSED, Open
from moteslam.slam.inputs.step import thin

LONGEST = 30.0  # A step by longer odometry [m] is the filter's: errors of that many metres are no prior
MAX_RANGE = 30.0
"""Endpoints farther from the sensor are left out [m]: neighbouring beams are half a metre apart there, and the error of
the heading moves them as far."""
FEW_POINTS = 20  # A scan of fewer points is not registered, and no node but the first


class Nodes:
    """The nodes so far: the first key scan, and each after which the next one would be too far from the node before."""

    def __init__(self, config: GraphConfig) -> None:
        self._config = config
        self.updates: list[int] = []  # which of the key scans they are
        self.indices: list[int] = []  # of their scans in the recording
        self.stamps: list[float] = []  # likewise
        self.scans: list[ThinnedScan] = []  # theirs, thinned, in the robot's frame
        self.origin = np.zeros(2)  # [2] where the rays start, in that frame [m]
        self.odometry: list[Array] = []  # [3] each: motion since the node before by odometry alone, in the frame there
        self.filtered: list[Array] = []  # [3] each: the same as the filter estimates it
        self.measured: list[bool] = []  # whether odometry measured all of it
        self.through: list[bool] = []  # whether since the node before there were enough nodes already
        self.left_open: list[Open] = []  # what a lapse of the odometry leaves open of that motion; nothing, of others
        self._keys = 0  # key scans so far
        self._last: KeyScan | None = None  # the latest, while it is no node
        # since the latest node
        self._odometry, self._filtered, self._known = np.zeros(3), np.zeros(3), True
        self._far, self._turn, self._open, self._through = 0.0, 0.0, CLOSED, False

    def __len__(self) -> int:
        return len(self.updates)

    def add(self, key: KeyScan, crowded: Callable[[], bool] = lambda: False) -> bool:
        """Take in a key scan; whether there is a new node: this one if it is the first, else the one before.

        ``crowded`` is whether there are enough nodes where the key scan before was taken.
        """
        distance, rotation = float(np.hypot(*key.motion[:2])), abs(float(key.motion[2]))
        too_far = self._far + distance > self._config.distance or self._turn + rotation > self._config.rotation
        through = too_far and crowded()
        added = too_far and not through and self.close()
        self._through |= through
        self._odometry = se2.compose(self._odometry, key.odometry)
        self._filtered = se2.compose(self._filtered, key.motion)
        self._known &= key.measured and self._far + distance < LONGEST
        self._open = self._open.plus(key.left_open)
        self._far, self._turn = self._far + distance, self._turn + rotation
        self._last, self._keys = key, self._keys + 1
        return self.close() if self._keys == 1 else added

    def place(self, poses: Array) -> None:
        """Place the nodes at poses [n, 3] of the filter; a step that this changes was not measured by odometry."""
        for k, step in enumerate(se2.between(poses[:-1], poses[1:]), start=1):
            off = se2.between(self.filtered[k], step)
            if self.through[k] or np.hypot(*off[:2]) > self._config.distance or abs(off[2]) > self._config.rotation:
                self.filtered[k], self.measured[k] = np.asarray(step), False

    def close(self) -> bool:
        """Make the latest key scan a node, unless it is one or has few points; whether it became one."""
        key = self._last
        if key is None:
            return False
        near: NDArray[np.bool_] = np.hypot(*(key.points - key.origin).T) < MAX_RANGE
        scan = thin(key.points[near], key.origin, self._config.thinning)
        if self.updates and len(scan.points) < FEW_POINTS:
            return False
        self.updates.append(self._keys - 1)
        self.indices.append(key.index)
        self.stamps.append(key.stamp)
        self.scans.append(scan)
        self.odometry.append(self._odometry)
        self.filtered.append(self._filtered)
        self.measured.append(self._known)
        self.through.append(self._through)
        self.left_open.append(self._open)
        self.origin = key.origin
        self._odometry, self._filtered, self._known = np.zeros(3), np.zeros(3), True
        self._far, self._turn, self._last, self._open, self._through = 0.0, 0.0, None, CLOSED, False
        return True
