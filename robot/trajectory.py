"""A trajectory: stamped poses. Its files: ``moteslam.robot.trajectories``."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.arrays import frozen
from moteslam.robot.issues import Issue
from moteslam.robot.summary import Summarised, span
from moteslam.robot.wording import counted

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Space:
    """The poses of a trajectory in space.

    Attributes:
        positions: [n, 3] x, y, z [m].
        rotations: [n, 3, 3] of the body in the frame of the positions.
    """

    positions: Array
    rotations: Array

    def __getitem__(self, index: NDArray[np.integer | np.bool_]) -> Space:
        return Space(self.positions[index], self.rotations[index])


@dataclass(frozen=True, eq=False, repr=False)
class Trajectory(Summarised):
    """Poses of a frame over time.

    Attributes:
        stamps: [n] float64 [s], not decreasing; equal stamps are kept in file order.
        poses: [n, 3] float64: x [m], y [m], theta [rad].
        oriented: whether the headings are known; else they are 0 and mean nothing.
        space: the poses in space, of a file whose poses are not all upright at one height; ``poses`` are projected.
        warnings: what was assumed or left out when it was read.
    """

    stamps: Array
    poses: Array
    oriented: bool = True
    space: Space | None = None
    warnings: tuple[Issue, ...] = ()

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

    def at(self, stamps: Array) -> Trajectory:
        """The trajectory in the plane at other stamps [m] [s], not decreasing, and held beyond its ends."""
        return Trajectory(stamps, se2.interpolate(self.stamps, self.poses, stamps), self.oriented)

    def _summary(self) -> str:
        return f"{counted(len(self), 'pose')}, {span(self.stamps)}, {self.length:.1f} m"
