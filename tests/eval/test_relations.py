"""Relations: by hand, and on the Intel log's own stamps."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.relations import evaluate_relations, read_relations
from moteslam.robot.trajectory import Trajectory

LINE = "{} {} {} {} 0 0 0 {}\n"


def write(folder: Path, *rows: tuple[float, ...]) -> Path:
    path = folder / "some.relations"
    path.write_text("".join(LINE.format(*row) for row in rows))
    return path


@pytest.fixture
def trajectory() -> Trajectory:
    """Straight along x, one metre a second; the stamp 2 belongs to two poses, 0.1 m apart."""
    stamps = np.array([0.0, 1.0, 2.0, 2.0, 3.0])
    return Trajectory(stamps, np.stack((np.array([0, 1, 2, 2.1, 3]), np.zeros(5), np.zeros(5)), axis=-1))


def test_errors_by_hand(tmp_path: Path, trajectory: Trajectory) -> None:
    relations = read_relations(write(tmp_path, (0, 1, 1.3, 0.4, 0), (0, 3, 3, 0, np.deg2rad(10))))
    result = evaluate_relations(trajectory, relations)
    assert (result.total, result.matched) == (2, 2)
    assert result.translation.max == pytest.approx(0.5)
    assert result.rotation_deg.max == pytest.approx(10)
    assert result.translation.mean == pytest.approx(0.25)
    # the angle too: seen from a pose turned by 10 degrees, the shift of 0 stays 0
    assert result.translation.min == pytest.approx(0)


def test_a_relation_backwards_in_time(tmp_path: Path, trajectory: Trajectory) -> None:
    result = evaluate_relations(trajectory, read_relations(write(tmp_path, (3, 1, -2, 0, 0))))
    assert result.translation.max == pytest.approx(0)


def test_repeated_stamps_take_the_first_pose_and_are_not_clear(tmp_path: Path, trajectory: Trajectory) -> None:
    relations = read_relations(write(tmp_path, (0, 2, 2, 0, 0), (2, 3, 1, 0, 0), (0, 3, 3.2, 0, 0)))
    result = evaluate_relations(trajectory, relations)
    assert result.matched == 3
    assert result.clear is not None
    assert result.clear.translation.count == 1
    assert result.clear.translation.max == pytest.approx(0.2)
    assert sorted([result.translation.min, result.translation.max]) == pytest.approx([0, 0.2])


def test_only_stamps_within_the_tolerance_match(tmp_path: Path, trajectory: Trajectory) -> None:
    relations = read_relations(write(tmp_path, (0.00005, 1, 1, 0, 0), (0.01, 1, 1, 0, 0), (0, 9, 1, 0, 0)))
    assert evaluate_relations(trajectory, relations).matched == 1
    assert evaluate_relations(trajectory, relations, tolerance=0.02).matched == 2
    assert evaluate_relations(trajectory, relations, interpolate=False).pairs == 1


def test_stamps_between_poses_are_interpolated(tmp_path: Path, trajectory: Trajectory) -> None:
    relations = read_relations(write(tmp_path, (0.25, 1, 0.75, 0, 0), (0.5, 2.5, 2.1, 0, 0), (-1, 1, 2, 0, 0)))
    result = evaluate_relations(trajectory, relations)
    assert (result.total, result.pairs, result.matched) == (3, 2, 0)
    assert result.errors == pytest.approx([0, 0.05])  # at 2.5 s the robot is at 2.55 m
    assert result.clear is result.at_stamps is None
    with pytest.raises(InputError, match="none of 3 relations"):
        evaluate_relations(trajectory, relations, interpolate=False)


def test_poses_far_apart_are_not_interpolated(tmp_path: Path) -> None:
    sparse = Trajectory(np.array([0.0, 5.0, 5.5]), np.zeros((3, 3)))
    relations = read_relations(write(tmp_path, (2.5, 5, 0, 0, 0), (5, 5.2, 0, 0, 0)))
    assert evaluate_relations(sparse, relations).pairs == 1


def test_angles_wrap(tmp_path: Path) -> None:
    trajectory = Trajectory(np.array([0.0, 1.0]), np.array([[0, 0, 3.1], [0, 0, -3.1]]))
    relations = read_relations(write(tmp_path, (0, 1, 0, 0, 2 * np.pi - 6.2)))
    assert evaluate_relations(trajectory, relations).rotation_deg.max == pytest.approx(0, abs=1e-9)


def test_relations_of_another_log(tmp_path: Path, trajectory: Trajectory) -> None:
    with pytest.raises(InputError, match="none of 1 relations has a pose"):
        evaluate_relations(trajectory, read_relations(write(tmp_path, (100, 101, 0, 0, 0))))


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no relations"),
        ("1 2 3\n", ":1: expected 8 finite numbers"),
        ("1 2 3 4 5 6 7 8\n1 2 3 4 5 6 7 nan\n", ":2: expected 8"),
        ("a b c d e f g h\n", ":1: expected 8"),
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
