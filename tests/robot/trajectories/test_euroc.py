"""EuRoC's CSV of ground truth; evo is the reference."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from trajectory_cases import made, trajectories

from moteslam.errors import InputError
from moteslam.robot.trajectories.columns import read_euroc, write_euroc
from moteslam.robot.trajectory import Trajectory

LINE = "1403636580838555648,4.5,-1.5,0.8,0.6,0,0,0.8,0.1,0.2,0.3\n"


@given(trajectories())
def test_poses_read_back_and_stamps_to_half_a_nanosecond(trajectory: Trajectory) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.csv"
        write_euroc(path, trajectory)
        again = read_euroc(path)
    late = trajectory.stamps > 1e7  # float64 is coarser than a nanosecond there
    assert again.stamps[late].tobytes() == trajectory.stamps[late].tobytes()
    assert (np.abs(again.stamps - trajectory.stamps) <= 0.5e-9 + np.spacing(trajectory.stamps)).all()
    np.testing.assert_array_equal(again.poses[:, :2], trajectory.poses[:, :2])
    np.testing.assert_allclose(again.poses[:, 2], trajectory.poses[:, 2], rtol=1e-15, atol=1e-15)


def test_it_is_written_and_read_as_evo_has_it(tmp_path: Path) -> None:
    from evo.tools import file_interface

    trajectory = made()
    write_euroc(tmp_path / "t.csv", trajectory)
    theirs = file_interface.read_euroc_csv_trajectory(tmp_path / "t.csv")
    np.testing.assert_allclose(theirs.timestamps, trajectory.stamps, atol=3e-7)  # evo rounds the nanoseconds first
    np.testing.assert_array_equal(theirs.positions_xyz[:, :2], trajectory.poses[:, :2])
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], trajectory.poses[:, 2], atol=1e-12)


def test_a_line_of_the_data_set_is_read(tmp_path: Path) -> None:
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    (tmp_path / "data.csv").write_text(header + LINE.replace(",", ", "))
    found = read_euroc(tmp_path / "data.csv")
    assert found.stamps.tolist() == [1403636580.838555648]
    np.testing.assert_allclose(found.poses, [[4.5, -1.5, 2 * np.arctan2(0.8, 0.6)]])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("#\n", r"e\.csv: no poses, expected EuRoC lines"),
        (LINE + "1.5,0,0,0,1,0,0,0\n", r"e\.csv:2: expected whole nanoseconds and finite numbers"),
        (LINE + "-1,0,0,0,1,0,0,0\n", r"e\.csv:2: stamp before the one above it"),
        (LINE + f"{'9' * 5000},0,0,0,1,0,0,0\n", r"e\.csv:2: stamp beyond 1e11 s"),
        (LINE + "1,0,0,0,1,0,0\n", r"e\.csv:2: expected whole nanoseconds and finite numbers"),
        (LINE + "1,0,0,0,1,0,0,nan\n", r"e\.csv:2: expected whole nanoseconds and finite numbers"),
        (LINE + LINE.replace("0.6,0,0,0.8", "0,0,0,0"), r"e\.csv:2: quaternion of length 0"),
        (LINE + LINE.replace("0.6,0,0,0.8", "0.5,0,0,0.5"), r"e\.csv:2: quaternion of length 0\.707"),
        (LINE + "1,0,0,0,1,0,0,0\n", r"e\.csv:2: stamp before the one above it"),
        ("200000000000000000000,0,0,0,1,0,0,0\n", r"e\.csv:1: stamp beyond 1e11 s"),
    ],
)
def test_bad_lines_are_told_with_their_number(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "e.csv").write_text(text)
    with pytest.raises(InputError, match=message):
        read_euroc(tmp_path / "e.csv")


def test_stamps_before_the_epoch_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="stamps: stamps below 0 or beyond 1e11 s"):
        write_euroc(tmp_path / "t.csv", Trajectory(np.array([-1.0]), np.zeros((1, 3))))
