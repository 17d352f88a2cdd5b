"""Relations: by hand, and on the Intel log's own stamps."""

from __future__ import annotations

import gzip
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.relations import RelationResult, evaluate_relations, read_relations
from moteslam.robot.trajectory import Trajectory

LINE = "{} {} {} {} 0 0 0 {}\n"


X = np.array([0, 1, 2, 2.1, 3])
DRIVE = Trajectory(np.array([0.0, 1.0, 2.0, 2.0, 3.0]), np.stack((X, 0 * X, 0 * X), axis=-1))
"""Straight along x, one metre a second; the stamp 2 belongs to two poses, 0.1 m apart."""


@pytest.fixture
def score(tmp_path: Path) -> Callable[..., RelationResult]:
    """Evaluate relations (t1, t2, x, y, yaw) of a file."""

    def evaluate(*rows: tuple[float, ...], drive: Trajectory = DRIVE, **options: Any) -> RelationResult:
        (tmp_path / "some.relations").write_text("".join(LINE.format(*row) for row in rows))
        return evaluate_relations(drive, read_relations(tmp_path / "some.relations"), **options)

    return evaluate


def test_errors_by_hand(score) -> None:
    result = score((0, 1, 1.3, 0.4, 0), (0, 3, 3, 0, np.deg2rad(10)))
    assert (result.total, result.matched) == (2, 2)
    assert (result.translation.max, result.rotation_deg.max) == pytest.approx((0.5, 10))
    # the angle too: seen from a pose turned by 10 degrees, the shift of 0 stays 0
    assert (result.translation.mean, result.translation.min) == pytest.approx((0.25, 0))
    assert score((3, 1, -2, 0, 0)).rmse == pytest.approx(0)  # backwards in time
    turned = Trajectory(np.array([0.0, 1.0]), np.array([[0, 0, 3.1], [0, 0, -3.1]]))
    assert score((0, 1, 0, 0, 2 * np.pi - 6.2), drive=turned).rotation.max == pytest.approx(0, abs=1e-9)


def test_repeated_stamps_take_the_first_pose_and_are_not_clear(score) -> None:
    result = score((0, 2, 2, 0, 0), (2, 3, 1, 0, 0), (0, 3, 3.2, 0, 0))
    assert result.matched == 3
    assert (result.clear.translation.count, result.clear.translation.max) == (1, pytest.approx(0.2))
    assert (result.translation.min, result.translation.max) == pytest.approx((0, 0.2))


def test_only_stamps_within_the_tolerance_match(score) -> None:
    rows = ((0.00005, 1, 1, 0, 0), (0.01, 1, 1, 0, 0), (0, 9, 1, 0, 0))
    assert (score(*rows).matched, score(*rows, tolerance=0.02).matched) == (1, 2)
    assert score(*rows, interpolate=False).pairs == 1


def test_stamps_between_poses_are_interpolated_but_not_far_apart(score) -> None:
    rows = ((0.25, 1, 0.75, 0, 0), (0.5, 2.5, 2.1, 0, 0), (-1, 1, 2, 0, 0))
    result = score(*rows)
    assert (result.total, result.pairs, result.matched) == (3, 2, 0)
    assert result.errors == pytest.approx([0, 0.05])  # at 2.5 s the robot is at 2.55 m
    assert result.clear is result.at_stamps is None
    with pytest.raises(InputError, match="none of 3 relations"):
        score(*rows, interpolate=False)
    sparse = Trajectory(np.array([0.0, 5.0, 5.5]), np.zeros((3, 3)))
    assert score((2.5, 5, 0, 0, 0), (5, 5.2, 0, 0, 0), drive=sparse).pairs == 1


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no lines"),
        ("1 2 3\n", ":1: expected 8 finite numbers"),
        ("1 2 3 4 5 6 7 8\n1 2 3 4 5 6 7 nan\n", ":2: expected 8"),
        ("a b c d e f g h\n", ":1: expected 8"),
        ("# degrees\n1 2 3 4 0 0 0 -5\n1 2 3 4 0 0 0 -90\n", ":3: yaw: an angle of -90"),
    ],
)
def test_bad_files(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.relations"
    path.write_text(text)
    with pytest.raises(InputError, match=message):
        read_relations(path)
    with pytest.raises(InputError, match="No such file"):
        read_relations(tmp_path / "absent")


def test_the_intel_log_has_452_clear_relations(data_folder: Path) -> None:
    """Raw odometry against the relations: the counts of the data's own README, and the figures of PEERS."""
    stamps, poses = [], []
    with gzip.open(data_folder / "intel/intel_raw_part.log.gz", "rt") as log:
        for line in log:
            words = line.split()
            if words and words[0] == "FLASER":
                stamps.append(float(words[-3]))
                poses.append([float(word) for word in words[-6:-3]])
    odometry = Trajectory(np.array(stamps), np.array(poses))
    assert len(odometry) == 5505
    result = evaluate_relations(odometry, read_relations(data_folder / "intel/intel.relations"))
    assert (result.total, result.matched) == (2984, 1030)
    assert result.clear is not None
    assert result.clear.translation.count == 452
    assert result.clear.translation.mean == pytest.approx(3.46, abs=0.01)
    assert result.clear.rotation_deg.mean == pytest.approx(39.5, abs=0.1)
    assert result.pairs > 1030
    alone = evaluate_relations(odometry, read_relations(data_folder / "intel/intel_raw_part.relations"))
    assert alone.clear.as_dict() == result.clear.as_dict() == alone.as_dict()["all"]
