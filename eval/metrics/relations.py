"""Relations between poses, checked by hand: a truth for real logs that no SLAM has written (Kuemmerle et al. 2009)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.eval.metrics.association import MAX_GAP
from moteslam.eval.statistics import Statistics
from moteslam.robot.files import open_regular
from moteslam.robot.formats.streams import MAX_JUMP
from moteslam.robot.recording import nearest_stamp
from moteslam.robot.se2 import Poses, between, wrap
from moteslam.robot.se2 import interpolate as interpolated
from moteslam.robot.trajectories.columns import data_lines, finite_numbers
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised, expect_type

TOLERANCE = 1e-4
"""Stamps of a relation and of a pose that are the same reading differ by less than this [s]."""

UPRIGHT = 0.2
"""Height [m], roll and pitch [rad] of a relation are less."""

HEAD = 100_000
"""Bytes by which a file of relations is known."""


@dataclass(frozen=True, eq=False, repr=False)
class Relations(Summarised):
    """Where the robot was at one time, seen from where it was at another.

    Attributes:
        stamps: [n, 2] the time of the frame and of the pose in it [s].
        poses: [n, 3] the pose at the second time in the frame of the first.
    """

    stamps: NDArray[np.float64]
    poses: Poses

    def __len__(self) -> int:
        return len(self.stamps)


@dataclass(frozen=True)
class RelationScore:
    """Errors over a set of relations.

    Attributes:
        translation: statistics of the distance [m].
        rotation: statistics of the absolute angle [deg].
    """

    translation: Statistics
    rotation: Statistics

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON."""
        return {"translation_m": self.translation.as_dict(), "rotation_deg": self.rotation.as_dict()}


@dataclass(frozen=True, eq=False, repr=False)
class RelationResult(Summarised):
    """How well a trajectory keeps the relations.

    Attributes:
        total: relations in the file.
        stamps: [n, 2] of all that were used [s].
        errors: [n] translation errors of these [m].
        rotation_errors: [n] their rotation errors [rad].
        is_at_stamps: [n] which have a pose at both of their stamps.
        is_clear: [n] whose stamps each belong to exactly one pose.
    """

    total: int
    stamps: NDArray[np.float64]
    errors: NDArray[np.float64]
    rotation_errors: NDArray[np.float64]
    is_at_stamps: NDArray[np.bool_]
    is_clear: NDArray[np.bool_]

    @property
    def used(self) -> int:
        """Number of relations that were used."""
        return len(self.errors)

    @property
    def matched(self) -> int:
        """Number of relations with a pose at both of their stamps."""
        return int(self.is_at_stamps.sum())

    @property
    def interpolated(self) -> int:
        """Number of relations that were used between poses."""
        return self.used - self.matched

    @cached_property
    def all(self) -> RelationScore:
        """Over all that were used."""
        found = self._over(np.ones(self.used, np.bool_))
        assert found is not None  # a result has at least one
        return found

    @cached_property
    def at_stamps(self) -> RelationScore | None:
        """Over those with a pose at both of their stamps, if there are any."""
        return self._over(self.is_at_stamps)

    @cached_property
    def clear(self) -> RelationScore | None:
        """Over those whose two stamps each belong to exactly one pose, if there are any."""
        return self._over(self.is_clear)

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON."""
        scores = {"all": self.all, "at_stamps": self.at_stamps, "clear": self.clear}
        return {
            "total": self.total,
            "used": self.used,
            "interpolated": self.interpolated,
            **{name: None if score is None else score.as_dict() for name, score in scores.items()},
        }

    def _over(self, some: NDArray[np.bool_]) -> RelationScore | None:
        if not some.any():
            return None
        turns = np.rad2deg(self.rotation_errors[some])
        return RelationScore(Statistics.of(self.errors[some]), Statistics.of(turns))


def is_relations(path: str | PathLike[str]) -> bool:
    """Whether a file holds relations rather than TUM poses; both are eight numbers a line.

    The last four of a TUM line are a quaternion: of length 1, or 0 throughout where there is no orientation. Of a
    relation they are 0, 0, 0 (or nearly) and an angle, which is not 1 rad in every line, and the first two are times of
    one clock. A file named ``.relations`` holds some; one that cannot be read, or has no such lines, holds none.
    """
    try:
        with open_regular(path, "relations") as file:
            head = file.read(HEAD).decode("utf-8-sig", errors="replace")
        text = head if len(head) < HEAD else head.rpartition("\n")[0]
        rows = np.array([line.split() for line in text.splitlines() if line.strip() and line[0] != "#"], np.float64)
    except (OSError, InputError, ValueError):
        return False
    if rows.ndim != 2 or rows.shape[1] != 8:
        return False
    if Path(path).suffix == ".relations":
        return True
    angles = (np.abs(rows[:, 4:7]) < UPRIGHT).all() and (np.abs(np.linalg.norm(rows[:, 4:], axis=1) - 1) > 0.01).any()
    clock = np.median(np.abs(rows[:, 1] - rows[:, 0])) < MAX_JUMP
    return bool(angles and clock and rows[:, 4:].any())


def read_relations(path: str | PathLike[str]) -> Relations:
    """Read ``t1 t2 x y z roll pitch yaw`` lines (metres, radians), of which x, y and yaw count.

    Raises:
        InputError: not a text file of at most 500 MB, a line without eight finite numbers, or no line.
    """
    path = Path(path)
    rows: list[list[float]] = []
    for number, line in data_lines(path, "relations"):
        row = finite_numbers(line.split())
        if row is None or len(row) != 8:
            raise InputError("expected 8 finite numbers: t1 t2 x y z roll pitch yaw", file=path, line=number)
        rows.append(row)
    if not rows:
        raise InputError("no relations, expected lines: t1 t2 x y z roll pitch yaw", file=path)
    table = np.array(rows)
    return Relations(table[:, :2], np.stack((table[:, 2], table[:, 3], wrap(table[:, 7])), axis=-1))


def evaluate_relations(
    trajectory: Trajectory, relations: Relations, *, interpolate: bool = True, tolerance: float = TOLERANCE
) -> RelationResult:
    """How far the trajectory's relative poses are from the relations'.

    The error of a relation is the pose est (-) ref, where both are the pose at t2 seen from the pose at t1: the
    length of its translation [m] and its absolute angle [deg].

    A log may repeat a stamp for distinct scans, and then it is unknown which of them a relation meant. The *clear*
    relations are those whose two stamps each belong to exactly one pose of the trajectory. Of several poses with one
    stamp the first stands for it. A stamp between two poses at most ``MAX_GAP`` apart has the pose
    interpolated there.

    Args:
        trajectory: a pose at every scan; equal stamps are distinct poses.
        relations: of the same log, on the same clock.
        interpolate: use relations whose stamps lie between poses, too.
        tolerance: between the stamps of a relation and of its pose [s].

    Raises:
        InputError: no relation can be used.
    """
    expect_type(trajectory, Trajectory, "trajectory", "read_trajectory(path) reads one")
    expect_type(relations, Relations, "relations", "read_relations(path) reads some")
    if not trajectory.oriented:
        raise InputError("a trajectory without orientation, expected headings: relations are poses")
    if not len(trajectory):
        raise InputError("a trajectory without poses, expected one at every scan")
    first, poses_there = _poses_at(trajectory.stamps, relations.stamps, tolerance)
    reachable = poses_there > 0
    exact = np.asarray(reachable.all(axis=1))
    if interpolate:
        reachable |= _enclosed(trajectory.stamps, relations.stamps)
    used = np.asarray(reachable.all(axis=1))
    if not used.any():
        raise InputError(
            f"none of {len(relations)} relations has a pose at both of its stamps, expected the relations of "
            f"this log: they cover {relations.stamps.min():.3f} to {relations.stamps.max():.3f} s, the trajectory "
            f"{trajectory.stamps[0]:.3f} to {trajectory.stamps[-1]:.3f} s"
        )
    stamps, at_pose = relations.stamps[used], poses_there[used] > 0
    between_poses = interpolated(trajectory.stamps, trajectory.poses, stamps.reshape(-1)).reshape(-1, 2, 3)
    poses = np.where(at_pose[..., None], trajectory.poses[first[used]], between_poses)
    errors = between(relations.poses[used], between(poses[:, 0], poses[:, 1]))
    distance, angle = np.hypot(errors[:, 0], errors[:, 1]), np.abs(errors[:, 2])

    return RelationResult(
        total=len(relations),
        stamps=stamps,
        errors=distance,
        rotation_errors=angle,
        is_at_stamps=exact[used],
        is_clear=np.asarray((poses_there[used] == 1).all(axis=1)),
    )


def _enclosed(stamps: NDArray[np.float64], wanted: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which of the stamps wanted [...] lie between two stamps [n] at most ``MAX_GAP`` apart."""
    after = np.searchsorted(stamps, wanted, side="left")
    inside = (after > 0) & (after < len(stamps))
    upper, lower = np.clip(after, 0, len(stamps) - 1), np.maximum(after - 1, 0)
    return np.asarray(inside & (stamps[upper] - stamps[lower] <= MAX_GAP))


def _poses_at(
    stamps: NDArray[np.float64], wanted: NDArray[np.float64], tolerance: float
) -> tuple[NDArray[np.intp], NDArray[np.intp]]:
    """For wanted stamps [...] the first pose with the stamp nearest, and how many poses have that very stamp.

    The count is 0 where no stamp [n] lies within the tolerance.
    """
    nearest = nearest_stamp(stamps, wanted)
    first = np.searchsorted(stamps, stamps[nearest], side="left")
    count = np.searchsorted(stamps, stamps[nearest], side="right") - first
    return first, np.where(np.abs(stamps[nearest] - wanted) <= tolerance, count, 0)
