"""A trajectory: stamped poses, and the TUM text format they are exchanged in."""

from __future__ import annotations

from dataclasses import dataclass
from os import PathLike
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot import se2
from moteslam.robot.arrays import frozen
from moteslam.robot.files import write_atomically
from moteslam.robot.reading import read_text
from moteslam.robot.summary import Summarised, span
from moteslam.robot.wording import counted, expect_type

MAX_BYTES = 500_000_000
"""No TUM file is larger: some five million poses."""


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


def write_tum(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``stamp x y z qx qy qz qw`` lines that read back to the same stamps, bit for bit.

    Stamps and coordinates are written with the fewest digits that round-trip (Unix seconds with microseconds keep
    them). The heading goes through a quaternion and comes back to within an ulp or two.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    half = trajectory.poses[:, 2] / 2
    rows = zip(
        trajectory.stamps.tolist(),
        trajectory.poses[:, 0].tolist(),
        trajectory.poses[:, 1].tolist(),
        np.sin(half).tolist(),
        np.cos(half).tolist(),
        strict=True,
    )
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [f"{stamp!r} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}" for stamp, x, y, qz, qw in rows]
    write_atomically(path, "\n".join(lines) + "\n")


def read_tum(path: str | PathLike[str]) -> Trajectory:
    """Read a TUM trajectory, projected to the plane (x, y and the rotation about z).

    Raises:
        InputError: no text file of at most ``MAX_BYTES``, a line without eight finite numbers, a quaternion of no
            length, stamps that go back, or no pose.
    """
    rows: list[list[float]] = []
    path = Path(path)
    text = read_text(path, "a TUM trajectory", limit=MAX_BYTES)
    for number, line in enumerate(text.splitlines(), start=1):
        words = line.replace(",", " ").split()
        if not words or words[0].startswith("#"):
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) != 8 or not np.isfinite(row).all():
            raise InputError("expected 8 finite numbers: stamp x y z qx qy qz qw", file=path, line=number)
        if not any(row[4:]):
            raise InputError("quaternion of length 0, expected a unit quaternion", file=path, line=number)
        if rows and row[0] < rows[-1][0]:
            raise InputError("stamp before the one above it, expected rising stamps", file=path, line=number)
        rows.append(row)
    if not rows:
        raise InputError("no poses, expected TUM lines: stamp x y z qx qy qz qw", file=path)
    table = np.array(rows)
    qx, qy, qz, qw = table[:, 4:].T
    theta = np.arctan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return Trajectory(table[:, 0], np.stack((table[:, 1], table[:, 2], se2.wrap(theta)), axis=-1))
