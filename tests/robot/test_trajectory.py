"""Trajectories and TUM files."""

from __future__ import annotations

import tempfile
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from moteslam.errors import InputError, OutputError
from moteslam.robot.trajectory import Trajectory, read_tum, write_tum

# no subnormals: a library in the same process (Taichi) may have the processor flush them to zero
NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
ROWS = st.lists(
    st.tuples(
        st.floats(0, 2e9, allow_subnormal=False),
        NUMBERS,
        NUMBERS,
        st.floats(-3.14159, 3.14159, allow_subnormal=False),
    ),
    min_size=1,
)


def made(n: int = 20) -> Trajectory:
    rng = np.random.default_rng(0)
    return Trajectory(1298445274.5 + np.cumsum(rng.uniform(0, 0.1, n)), rng.normal(size=(n, 3)))


@given(ROWS)
def test_tum_keeps_stamps_and_positions_bit_for_bit(rows: list[tuple[float, ...]]) -> None:
    table = np.array(sorted(rows, key=lambda row: row[0]))
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.tum"
        write_tum(path, Trajectory(table[:, 0], table[:, 1:]))
        again = read_tum(path)
    assert again.stamps.tobytes() == table[:, 0].tobytes()
    np.testing.assert_array_equal(again.poses[:, :2], table[:, 1:3])
    np.testing.assert_allclose(again.poses[:, 2], table[:, 3], rtol=1e-15, atol=1e-15)


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
    path.write_text("# head\n\n1.5, 1, 2, 3, 0, 0, 0.5, 0.5\n2.5 1 2 3 0.1 0 0 2\n")
    trajectory = read_tum(path)
    np.testing.assert_allclose(trajectory.poses, [[1, 2, np.pi / 2], [1, 2, 0]], atol=1e-15)


GOOD = "1 0 0 0 0 0 0 1\n"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "no poses, expected TUM lines"),
        ("# only\n", "no poses"),
        (GOOD + "2 0 0 0 0 0 0\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 0 0 0 0 1 5\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 nan 0 0 0 1\n", r":2: expected 8 finite numbers"),
        (GOOD + "2 0 0 inf 0 0 0 1\n", r":2: expected 8 finite numbers"),
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


def test_length_and_interpolation() -> None:
    trajectory = Trajectory(np.arange(3.0), np.array([[0.0, 0, 0], [3, 4, 0], [3, 5, 1]]))
    assert trajectory.length == pytest.approx(6.0)
    assert len(trajectory) == 3
    np.testing.assert_allclose(trajectory.at(np.array([0.5, 7.0])).poses, [[1.5, 2, 0], [3, 5, 1]])


def test_arrays_are_frozen_and_checked() -> None:
    trajectory = made()
    with pytest.raises(ValueError, match="read-only"):
        trajectory.poses[0, 0] = 1
    bad: NDArray[np.float64] = np.zeros((4, 2))
    with pytest.raises(InputError, match=r"expected \[n\] and \[n, 3\]"):
        Trajectory(np.arange(4.0), bad)
