"""The nodes of the graph: key scans some distance or turn apart."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.kernels.thinning import ThinnedScan
from moteslam.robot import se2
from moteslam.slam.backend.protocol import KeyScan
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.inputs.thinning import thin

Array = NDArray[np.float64]

MAX_RANGE = 30.0
"""Endpoints farther from the sensor are left out [m]: neighbouring beams are half a metre apart there, and the error of
the heading moves them as far."""


@dataclass(frozen=True, eq=False)
class Nodes:
    """n nodes.

    Attributes:
        updates: [n] which of the key scans they are.
        indices, stamps: [n] of their scans in the recording.
        scans: theirs, thinned, in the robot's frame.
        origin: [2] where the rays start, in that frame [m].
        odometry: [n, 3] motion since the node before by odometry alone, in the frame of the pose there.
        measured: [n] whether odometry measured all of it.
    """

    updates: NDArray[np.intp]
    indices: NDArray[np.intp]
    stamps: Array
    scans: tuple[ThinnedScan, ...]
    origin: Array
    odometry: Array
    measured: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.updates)


def choose_nodes(keys: list[KeyScan], path: Array, distance: float, rotation: float, thinning: ThinningConfig) -> Nodes:
    """The key scans that become nodes: as few as leave no two neighbours farther apart than need be.

    The first and the last are; another one is where the next would be too far from the node before.

    Args:
        keys: all u key scans.
        path: [u, 3] their poses.
        distance: between two nodes, where key scans allow [m].
        rotation: likewise [rad].
        thinning: of their scans.
    """
    steps = np.asarray(se2.between(path[:-1], path[1:]))
    driven, turned = np.hypot(steps[:, 0], steps[:, 1]), np.abs(steps[:, 2])
    chosen, odometry, measured = [0], [np.zeros(3)], [True]
    motion, known, far, turn = np.zeros(3), True, 0.0, 0.0
    for k in range(1, len(keys)):
        motion, known = np.asarray(se2.compose(motion, keys[k].odometry)), known and keys[k].measured
        far, turn = far + float(driven[k - 1]), turn + float(turned[k - 1])
        last = k == len(keys) - 1
        if last or far + float(driven[k]) > distance or turn + float(turned[k]) > rotation:
            chosen.append(k)
            odometry.append(motion)
            measured.append(known)
            motion, known, far, turn = np.zeros(3), True, 0.0, 0.0
    some = [keys[k] for k in chosen]
    return Nodes(
        updates=np.array(chosen),
        indices=np.array([key.index for key in some]),
        stamps=np.array([key.stamp for key in some]),
        scans=tuple(thin(_near(key), key.origin, thinning) for key in some),
        origin=keys[0].origin,
        odometry=np.array(odometry),
        measured=np.array(measured),
    )


def _near(key: KeyScan) -> NDArray[np.float32]:
    near: NDArray[np.bool_] = np.hypot(*(key.points - key.origin).T) < MAX_RANGE
    return np.asarray(key.points[near])
