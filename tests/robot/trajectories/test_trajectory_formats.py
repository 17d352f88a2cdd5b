"""Files of trajectories: what is written reads back, evo reads it as we do, broken lines are named by their number."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.trajectories import read_trajectory, write_trajectory
from moteslam.robot.trajectories.text import read_kitti, read_tum, write_euroc
from moteslam.robot.trajectory import Trajectory

# no subnormals: a library in the same process (Taichi) may have the processor flush them to zero
NUMBERS = st.floats(-1e6, 1e6, allow_subnormal=False)
HEADINGS = st.floats(-3.14159, 3.14159, allow_subnormal=False)


def made(n: int = 20, seed: int = 0) -> Trajectory:
    """Poses on a random walk, on the clock of Unix."""
    generator = np.random.default_rng(seed)
    return Trajectory(1298445274.5 + np.cumsum(generator.uniform(0, 0.1, n)), generator.normal(size=(n, 3)))


@st.composite
def trajectories(draw: st.DrawFn, latest: float = 2e9) -> Trajectory:
    """Any poses at any stamps from 0 to the latest [s], equal ones among them."""
    row = st.tuples(st.floats(0, latest, allow_subnormal=False), NUMBERS, NUMBERS, HEADINGS)
    table = np.array(sorted(draw(st.lists(row, min_size=1, max_size=12)), key=lambda row: row[0]))
    return Trajectory(table[:, 0], table[:, 1:])


@pytest.mark.parametrize("name", ["tum", "kitti", "euroc", "g2o"])
@given(trajectories())
def test_it_reads_back(name: str, trajectory: Trajectory) -> None:
    """Positions bit for bit, headings to an ulp, stamps bit for bit but in EuRoC's nanoseconds."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "t.txt"
        write_trajectory(path, trajectory, name)
        again = read_trajectory(path)
    coarse = trajectory.stamps > (1e7 if name == "euroc" else -1)  # float64 is coarser than a nanosecond there
    assert again.stamps[coarse].tobytes() == trajectory.stamps[coarse].tobytes()
    assert (np.abs(again.stamps - trajectory.stamps) <= 0.5e-9 + np.spacing(trajectory.stamps)).all()
    np.testing.assert_array_equal(again.poses[:, :2], trajectory.poses[:, :2])
    np.testing.assert_allclose(again.poses[:, 2], trajectory.poses[:, 2], rtol=1e-15, atol=1e-15)


@pytest.mark.parametrize(
    ("name", "reader"),
    [
        ("tum", "read_tum_trajectory_file"),
        ("euroc", "read_euroc_csv_trajectory"),
        ("kitti", "read_kitti_poses_file"),
    ],
)
def test_it_is_read_as_evo_reads_it(tmp_path: Path, name: str, reader: str) -> None:
    from evo.core.trajectory import PosePath3D
    from evo.tools import file_interface

    trajectory = made()
    write_trajectory(tmp_path / "t", trajectory, name)
    theirs: Any = getattr(file_interface, reader)(tmp_path / "t")
    if name == "kitti":
        file_interface.write_kitti_poses_file(tmp_path / "theirs", PosePath3D(poses_se3=theirs.poses_se3))
        (tmp_path / "times.txt").write_text((tmp_path / "t.times.txt").read_text())
        np.testing.assert_allclose(read_kitti(tmp_path / "theirs").poses, trajectory.poses, atol=1e-12)
    else:
        np.testing.assert_allclose(theirs.timestamps, trajectory.stamps, rtol=0, atol=3e-7)  # evo rounds nanoseconds
    np.testing.assert_allclose(theirs.positions_xyz[:, :2], trajectory.poses[:, :2], atol=1e-15)
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], trajectory.poses[:, 2], atol=1e-12)


TUM = "1 0 0 0 0 0 0 1\n"
EUROC = "1403636580838555648,4.5,-1.5,0.8,0.6,0,0,0.8,0.1,0.2,0.3\n"
KITTI = "1 0 0 2 0 1 0 3 0 0 1 4\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        (None, None),
        ("", None),
        ("# one\n\n1 2 3\n", 3),
        ("1,2,3,,4,5,6,7\n", 1),
        ("\udcff\udcfe\0", 1),
        (TUM + "2 \udcff\n", None),
        (TUM + "2 0 0 0 0 0 0 1 5\n", 2),
        (TUM + "2 0 0 nan 0 0 0 1\n", 2),
        (TUM + "2 0 1e300 0 0 0 0 1\n", 2),
        (TUM + "2 0 0 0 0 0 0 0\n", 2),
        (TUM + "0.5 0 0 0 0 0 0 1\n", 2),
        (EUROC + "1.5,0,0,0,1,0,0,0\n", 2),
        (EUROC + f"{'9' * 5000},0,0,0,1,0,0,0\n", 2),
        (EUROC + EUROC.replace("0.6,0,0,0.8", "0.5,0,0,0.5"), 2),
        ("200000000000000000000,0,0,0,1,0,0,0\n", 1),
        (KITTI + KITTI[2:], 2),
        (KITTI + "# here\n" + KITTI.replace("1", "2"), 3),
    ],
)
def test_what_is_broken_is_named_by_its_line(tmp_path: Path, text: str | None, line: int | None) -> None:
    path = tmp_path / "t"
    if text is not None:
        path.write_bytes(text.encode("utf-8", "surrogateescape"))
    with pytest.raises(InputError) as caught:
        read_trajectory(path)
    assert (caught.value.file, caught.value.line) == (str(path), line)


@pytest.mark.parametrize(("times", "line"), [("1\n", None), ("1 2\n3\n", 1), ("1\ninf\n", 2), ("2\n1\n", 2)])
def test_times_that_do_not_fit_are_refused(tmp_path: Path, times: str, line: int | None) -> None:
    (tmp_path / "k.kitti").write_text(2 * KITTI)
    (tmp_path / "times.txt").write_text(times)
    with pytest.raises(InputError) as caught:
        read_kitti(tmp_path / "k.kitti")
    assert (caught.value.file, caught.value.line) == (str(tmp_path / "times.txt"), line)


def test_without_times_there_is_one_a_second_and_a_warning(tmp_path: Path) -> None:
    (tmp_path / "p.txt").write_text(2 * KITTI)
    found = read_trajectory(tmp_path / "p.txt")
    assert [issue.code for issue in found.warnings] == ["no-stamps"]
    assert found.stamps.tolist() == [0, 1]
    assert found.poses.tolist() == [[2, 3, 0], [2, 3, 0]]


def test_a_tilted_pose_is_projected_and_equal_stamps_are_kept(tmp_path: Path) -> None:
    path = tmp_path / "t.tum"
    path.write_text("# head\n\n1.5, 1, 2, 3, 0, 0, 0.6, 0.8\n1.5 1 2 3 0.1 0 0 0.995\n")
    np.testing.assert_allclose(read_tum(path).poses, [[1, 2, 2 * np.arctan2(0.6, 0.8)], [1, 2, 0]], atol=1e-15)


def test_what_cannot_be_written_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError):
        write_trajectory(tmp_path / "t.txt", made())
    with pytest.raises(ConfigError) as caught:
        write_trajectory(tmp_path / "t.txt", made(), "bag")
    assert caught.value.field == "file_format"
    with pytest.raises(InputError) as refused:
        write_euroc(tmp_path / "t.csv", Trajectory(np.array([-1.0]), np.zeros((1, 3))))
    assert refused.value.field == "stamps"


def test_length_and_interpolation() -> None:
    trajectory = Trajectory(np.arange(3.0), np.array([[0.0, 0, 0], [3, 4, 0], [3, 5, 1]]))
    assert trajectory.length == pytest.approx(6.0)
    assert len(trajectory) == 3
    np.testing.assert_allclose(trajectory.at(np.array([0.5, 7.0])).poses, [[1.5, 2, 0], [3, 5, 1]])
