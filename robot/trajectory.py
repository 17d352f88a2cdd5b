"""A trajectory: stamped poses. Its files: ``moteslam.robot.trajectories``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.arrays import frozen
from moteslam.robot.summary import Summarised, span
from moteslam.robot.wording import counted


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Summarised):
    """Poses of a frame over time.

    Attributes:
        stamps: [n] float64 [s], not decreasing; equal stamps are kept in file order.
        poses: [n, 3] float64: x [m], y [m], theta [rad].
    """

    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]

    def __post_init__(self) -> None:
        stamps, poses = frozen(self.stamps, np.float64), frozen(self.poses, np.float64)
        if stamps.ndim != 1 or poses.shape != (len(stamps), 3):
            raise InputError(f"stamps {list(stamps.shape)} and poses {list(poses.shape)}, expected [n] and [n, 3]")
        if (np.diff(stamps) < 0).any():
            raise InputError("stamps go back, expected rising seconds", field="stamps")
        object.__setattr__(self, "stamps", stamps)
        object.__setattr__(self, "poses", poses)

    def __len__(self) -> int:
        return len(self.stamps)

    @property
    def length(self) -> float:
        """The distance travelled [m]: the sum of the steps between poses."""
        return float(np.hypot(*np.diff(self.poses[:, :2], axis=0).T).sum())

    def at(self, stamps: NDArray[np.float64]) -> Trajectory:
        """The trajectory interpolated at other stamps [m] [s], not decreasing, and held beyond its ends."""
        return Trajectory(stamps, se2.interpolate(self.stamps, self.poses, stamps))

    def _summary(self) -> str:
        return f"{counted(len(self), 'pose')}, {span(self.stamps)}, {self.length:.1f} m"
