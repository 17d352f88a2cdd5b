"""KITTI's twelve numbers a line, with the stamps beside; evo is the reference."""

from __future__ import annotations

import tempfile
import warnings
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from trajectory_cases import made, trajectories

from moteslam.errors import InputError
from moteslam.robot.trajectories.kitti import read_kitti, write_kitti
from moteslam.robot.trajectory import Trajectory

LEVEL = "1 0 0 2 0 1 0 3 0 0 1 4\n"


@given(trajectories())
def test_poses_and_stamps_read_back(trajectory: Trajectory) -> None:
    for camera_axes in (False, True):
        with tempfile.TemporaryDirectory() as folder, warnings.catch_warnings():
            warnings.simplefilter("error")
            path = Path(folder) / "t.kitti"
            write_kitti(path, trajectory, camera_axes=camera_axes)
            again = read_kitti(path, camera_axes=camera_axes)
        assert again.stamps.tobytes() == trajectory.stamps.tobytes()
        np.testing.assert_array_equal(again.poses[:, :2], trajectory.poses[:, :2])
        np.testing.assert_allclose(again.poses[:, 2], trajectory.poses[:, 2], rtol=1e-15, atol=1e-15)


def test_it_is_written_and_read_as_evo_has_it(tmp_path: Path) -> None:
    from evo.core.trajectory import PosePath3D
    from evo.tools import file_interface

    trajectory = made()
    write_kitti(tmp_path / "t.kitti", trajectory)
    theirs = file_interface.read_kitti_poses_file(tmp_path / "t.kitti")
    np.testing.assert_allclose(theirs.positions_xyz[:, :2], trajectory.poses[:, :2], atol=1e-15)
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], trajectory.poses[:, 2], atol=1e-12)
    file_interface.write_kitti_poses_file(tmp_path / "theirs.txt", PosePath3D(poses_se3=theirs.poses_se3))
    (tmp_path / "times.txt").write_text((tmp_path / "t.times.txt").read_text())
    ours = read_kitti(tmp_path / "theirs.txt")
    np.testing.assert_array_equal(ours.stamps, trajectory.stamps)
    np.testing.assert_allclose(ours.poses, trajectory.poses, atol=1e-12)


def test_a_camera_that_drives_ahead_and_turns_left_is_such_a_robot(tmp_path: Path) -> None:
    # z is ahead, x right; the second pose is 2 m ahead and 1 m to the left, a quarter turn about the upward -y
    (tmp_path / "c.kitti").write_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 -1 -1 0 1 0 0.3 1 0 0 2\n")
    (tmp_path / "c.times.txt").write_text("0\n1\n")
    found = read_kitti(tmp_path / "c.kitti", camera_axes=True)
    np.testing.assert_allclose(found.poses, [[0, 0, 0], [2, 1, np.pi / 2]], atol=1e-15)
    plain = read_kitti(tmp_path / "c.kitti")
    assert [issue.code for issue in plain.warnings] == ["out-of-plane"]
    np.testing.assert_allclose(plain.poses[1, :2], [-1, 0.3])


def test_without_times_there_is_one_a_second_and_a_warning(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text(2 * LEVEL)
    found = read_kitti(tmp_path / "p.txt")
    assert [issue.code for issue in found.warnings] == ["no-stamps"]
    assert found.stamps.tolist() == [0, 1]
    assert found.poses.tolist() == [[2, 3, 0], [2, 3, 0]]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("# none\n", r"k\.kitti: no poses, expected KITTI lines"),
        (LEVEL + LEVEL[2:], r"k\.kitti:2: expected 12 finite numbers"),
        (LEVEL.replace("4", "nan"), r"k\.kitti:1: expected 12 finite numbers"),
        (LEVEL + "# here\n" + LEVEL.replace("1", "2"), r"k\.kitti:3: expected a rotation matrix"),
        (LEVEL.replace("1", "-1"), r"k\.kitti:1: expected a rotation matrix"),
    ],
)
def test_bad_lines_are_told_with_their_number(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "k.kitti").write_text(text)
    with pytest.raises(InputError, match=message):
        read_kitti(tmp_path / "k.kitti")


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n", r"times\.txt: 1 time, expected 2, one a pose"),
        ("1 2\n3\n", r"times\.txt:1: expected a finite number \[s\]"),
        ("1\ninf\n", r"times\.txt:2: expected a finite number \[s\]"),
        ("2\n1\n", r"times\.txt:2: stamp before the one above it"),
    ],
)
def test_times_that_do_not_fit_are_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "k.kitti").write_text(2 * LEVEL)
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(InputError, match=message):
        read_kitti(tmp_path / "k.kitti")
