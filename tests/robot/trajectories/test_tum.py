"""TUM files of trajectories."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from trajectory_cases import made, trajectories

from moteslam.errors import InputError, OutputError
from moteslam.robot.trajectories.columns import read_tum, write_tum
from moteslam.robot.trajectory import Trajectory


@given(trajectories())
def test_tum_keeps_stamps_and_positions_bit_for_bit(trajectory: Trajectory) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.tum"
        write_tum(path, trajectory)
        again = read_tum(path)
    assert again.stamps.tobytes() == trajectory.stamps.tobytes()
    np.testing.assert_array_equal(again.poses[:, :2], trajectory.poses[:, :2])
    np.testing.assert_allclose(again.poses[:, 2], trajectory.poses[:, 2], rtol=1e-15, atol=1e-15)


def test_tum_is_read_as_evo_reads_it(tmp_path: Path) -> None:
    from evo.tools import file_interface

    trajectory = made()
    write_tum(tmp_path / "t.tum", trajectory)
    theirs = file_interface.read_tum_trajectory_file(tmp_path / "t.tum")
    np.testing.assert_array_equal(theirs.timestamps, trajectory.stamps)
    np.testing.assert_array_equal(theirs.positions_xyz[:, :2], trajectory.poses[:, :2])
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], trajectory.poses[:, 2], atol=1e-12)


def test_a_tilted_pose_is_projected_and_commas_and_comments_are_read(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("# head\n\n1.5, 1, 2, 3, 0, 0, 0.6, 0.8\n2.5 1 2 3 0.1 0 0 0.995\n")
    trajectory = read_tum(path)
    np.testing.assert_allclose(trajectory.poses, [[1, 2, 2 * np.arctan2(0.6, 0.8)], [1, 2, 0]], atol=1e-15)


GOOD = "1 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses, expected a TUM trajectory"),
        ("# only\n", "no poses"),
        (GOOD + "2 0 0 0 0 0 0\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 0 0 0 0 1 5\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 nan 0 0 0 1\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 inf 0 0 0 1\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 1e300 0 0 0 0 1\n", r":2: position beyond 1e\+09 m"),
        (GOOD + "two 0 0 0 0 0 0 1\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 0 0 0 0 0\n", r":2: quaternion of length 0"),
        (GOOD + "0.5 0 0 0 0 0 0 1\n", r":2: stamp before the one above it"),
    ],
)
def test_bad_lines_are_told_with_their_number(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "t.tum"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_tum(path)
    assert str(caught.value).startswith(str(path))


def test_files_that_are_none(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="No such file or directory, expected a TUM trajectory"):
        read_tum(tmp_path / "none.tum")
    (tmp_path / "b.tum").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not UTF-8 text, expected a TUM trajectory"):
        read_tum(tmp_path / "b.tum")
    with pytest.raises(OutputError, match="cannot be written"):
        write_tum(tmp_path / "no" / "t.tum", made())


def test_equal_stamps_are_kept(tmp_path: Path) -> None:
    (tmp_path / "t.tum").write_text(GOOD + GOOD.replace("1 0", "1 5", 1))
    assert read_tum(tmp_path / "t.tum").poses[:, 0].tolist() == [0, 5]
