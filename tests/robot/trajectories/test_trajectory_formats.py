"""Files of trajectories: written ones read back, as evo reads them; columns by their names; broken ones are refused."""

import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refusal

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.trajectories import read_trajectory, write_trajectory
from moteslam.robot.trajectories.text import read_kitti, read_tum, write_euroc
from moteslam.robot.trajectory import Space, Trajectory

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
    with refusal(InputError, file=path, line=line):
        read_trajectory(path)


@pytest.mark.parametrize(("times", "line"), [("1\n", None), ("1 2\n3\n", 1), ("1\ninf\n", 2), ("2\n1\n", 2)])
def test_times_that_do_not_fit_are_refused(tmp_path: Path, times: str, line: int | None) -> None:
    (tmp_path / "k.kitti").write_text(2 * KITTI)
    (tmp_path / "times.txt").write_text(times)
    with refusal(InputError, file=tmp_path / "times.txt", line=line):
        read_kitti(tmp_path / "k.kitti")


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
    with refusal(ConfigError, field="file_format"):
        write_trajectory(tmp_path / "t.txt", made(), "bag")
    with refusal(InputError, field="stamps"):
        write_euroc(tmp_path / "t.csv", Trajectory(np.array([-1.0]), np.zeros((1, 3))))


def test_length_and_interpolation() -> None:
    trajectory = Trajectory(np.arange(3.0), np.array([[0.0, 0, 0], [3, 4, 0], [3, 5, 1]]))
    assert trajectory.length == pytest.approx(6.0)
    assert len(trajectory) == 3
    np.testing.assert_allclose(trajectory.at(np.array([0.5, 7.0])).poses, [[1.5, 2, 0], [3, 5, 1]])


T0 = 1403636579.763555
STAMPS = T0 + np.arange(12) / 20
X, Y, YAW = np.cos(0.3 * np.arange(12)), np.sin(0.5 * np.arange(12)), 0.2 * np.arange(12)
QZ, QW = np.sin(YAW / 2), np.cos(YAW / 2)
NS = [round(stamp * 10**9) for stamp in STAMPS.tolist()]
ZERO = [0.0] * 12
ALL = {
    "t": STAMPS.tolist(), "ns": NS, "us": [n // 1000 for n in NS], "ms": [n / 1e6 for n in NS], "n": list(range(12)),
    "x": X.tolist(), "y": Y.tolist(), "mmx": (1000 * X).tolist(), "mmy": (1000 * Y).tolist(), "z": ZERO, "0": ZERO,
    "qz": QZ.tolist(), "qw": QW.tolist(), "yaw": YAW.tolist(), "deg": np.rad2deg(YAW).tolist(), "word": ["map"] * 12,
    "sec": [n // 10**9 for n in NS], "nsec": [n % 10**9 for n in NS], "junk": [7.5] * 12, "empty": [""] * 12,
    "start": [0.05 * k for k in range(12)],
}  # fmt: skip


def written(path: Path, header: str, columns: str, separator: str = ",", encoding: str = "utf-8") -> Path:
    """A file of columns of ``ALL`` under a header."""
    rows = zip(*(ALL[name] for name in columns.split()), strict=True)
    lines = [header] if header else []
    lines += [separator.join(value if isinstance(value, str) else repr(value) for value in row) for row in rows]
    path.write_bytes(("\r\n".join(lines) + "\r\n").encode(encoding))
    return path


READ = [
    ("#num,t,x,y,z,qx,qy,qz,qw", "n t x y z 0 0 qz qw", ","),
    ("num;t;x;y;z;qx;qy;qz;qw", "n t x y z 0 0 qz qw", ";"),
    ("# timestamp tx ty tz qx qy qz qw", "t x y z 0 0 qz qw", " "),
    ("# timestamp [s] tx [m] ty [m] tz [m] qw qx qy qz", "t x y z qw 0 0 qz", " "),
    ("#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
     "v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1]", "ns x y z qw 0 0 qz junk junk", ","),
    ("time_ns,pos_x,pos_y,pos_z,quat_x,quat_y,quat_z,quat_w", "ns x y z 0 0 qz qw", ","),
    ("time [us],x [mm],y [mm],theta [deg]", "us mmx mmy deg", ","),
    ("stamp,frame,x,y,yaw_deg,cov_x_x,cov_y_y,std_x", "t word x y deg junk junk empty", ","),
    ("%time,field.header.seq,field.header.stamp,field.header.frame_id,field.pose.pose.position.x,"
     "field.pose.pose.position.y,field.pose.pose.position.z,field.pose.pose.orientation.x,"
     "field.pose.pose.orientation.y,field.pose.pose.orientation.z,field.pose.pose.orientation.w,field.pose.covariance0,"
     "field.twist.twist.linear.x", "start n ns word x y z 0 0 qz qw junk junk", ","),
    ("Time,header.seq,header.stamp.secs,header.stamp.nsecs,pose.position.x,pose.position.y,pose.orientation.x,"
     "pose.orientation.y,pose.orientation.z,pose.orientation.w", "start n sec nsec x y 0 0 qz qw", ","),
    ("__time,/odom/pose/pose/position/x,/odom/pose/pose/position/y,/odom/pose/pose/orientation/x,"
     "/odom/pose/pose/orientation/y,/odom/pose/pose/orientation/z,/odom/pose/pose/orientation/w,"
     "/odom/twist/twist/angular/z", "t x y 0 0 qz qw junk", ","),
    ('"timestamp","position_x","position_y","roll","pitch","yaw"', "t x y 0 0 yaw", ","),
    ("", "t x y z 0 0 qz qw", " "),
    ("", "t x y z 0 0 qz qw", ","),
    ("", "ns x y z 0 0 qz qw", " "),
    ("", "ns x y z qw 0 0 qz junk junk", ","),
    ("# a path in words\n# x y of the robot at time t", "t x y z 0 0 qz qw", " "),
    ("# the time t and x and x again", "t x y z 0 0 qz qw", " "),
]  # fmt: skip


@pytest.mark.parametrize(
    ("header", "columns", "separator", "encoding"),
    [*((*row, "utf-8") for row in READ), *((*READ[0], encoding) for encoding in ("utf-8-sig", "utf-16"))],
)
def test_columns_by_their_names(tmp_path: Path, header: str, columns: str, separator: str, encoding: str) -> None:
    found = read_trajectory(written(tmp_path / "t.csv", header, columns, separator, encoding))
    np.testing.assert_allclose(found.stamps, STAMPS, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :2], np.column_stack((X, Y)), atol=1e-12)
    np.testing.assert_allclose(np.unwrap(found.poses[:, 2]), YAW, atol=1e-12)
    assert found.oriented


@pytest.mark.parametrize(
    ("header", "columns", "code"),
    [
        ("timestamp,x,y,yaw", "ns x y yaw", "stamps-scaled"),
        ("time [s],x,y,yaw", "us x y yaw", "stamps-scaled"),
        ("", "ns x y z 0 0 qz qw", "stamps-scaled"),
        ("", "ns x y z qw 0 0 qz", "orientation-order"),
        ("t,x,y,z", "t x y z", "no-orientation"),
        ("t,x,y,heading", "t x y yaw", "no-orientation"),
        ("time [ns],x,y,yaw", "n x y yaw", "stamps-unlikely"),
    ],
)
def test_what_is_assumed_is_told(tmp_path: Path, header: str, columns: str, code: str) -> None:
    found = read_trajectory(written(tmp_path / "t.csv", header, columns, "," if header or "qw 0" in columns else " "))
    assert [issue.code for issue in found.warnings] == [code]
    assert found.warnings[0].message.startswith(f"{tmp_path / 't.csv'}: ")


@pytest.mark.parametrize(
    ("text", "stamp", "heading"),
    [
        ("1,0,0,0,0,0,0,1\n2,0,0,0,0,0,0,1\n", 1, 0.0),  # TUM with commas: the last is qw
        ("#timestamp [ns],x\n1,0,0,0,0,0,0,1\n", 1e-9, np.pi),  # EuRoC by its header: the last is qz
        ("1403636580838555648,0,0,0,0,0,0,1,0,0,0\n", 1403636580.838555648, np.pi),  # and by its columns
        ("1403636580838555648,0,0,0,0.6,0,0,0.8\n", 1403636580.838555648, 2 * np.arctan2(0.8, 0.6)),  # or stamps
        ("1403636580838555648,0,0,0,0,0,0.6,0.8\n", 1403636580.838555648, 2 * np.arctan2(0.6, 0.8)),  # upright so
    ],
)
def test_commas_alone_do_not_make_it_euroc(tmp_path: Path, text: str, stamp: float, heading: float) -> None:
    (tmp_path / "t").write_text(text)
    found = read_trajectory(tmp_path / "t")
    assert found.stamps[0] == stamp
    assert found.poses[0, 2] == pytest.approx(heading)


@pytest.mark.parametrize(
    ("header", "columns", "line"),
    [
        ("num,x,y,z,qx,qy,qz,qw", "n x y z 0 0 qz qw", 1),
        ("timestamp,latitude,longitude,altitude", "t x y z", 1),
        ("sec,usec,x,y,yaw", "sec n x y yaw", 1),
        ("t,x,z,qx,qy,qz,qw", "t x z 0 0 qz qw", 1),
        ("t,x,y,pose.x,yaw", "t x y x yaw", 1),
        ("t,x [ft],y [ft],yaw", "t x y yaw", 1),
        ("t,x,y,yaw", "t x y deg", None),
        ("", "n t x y z 0 0 qz qw", 1),
        ("t,x,y,yaw", "t x empty yaw", 2),
    ],
)
def test_what_is_not_clear_is_refused(tmp_path: Path, header: str, columns: str, line: int | None) -> None:
    path = written(tmp_path / "t.csv", header, columns)
    with refusal(InputError, file=path, line=line):
        read_trajectory(path)


def test_semicolons_go_with_decimal_commas(tmp_path: Path) -> None:
    (tmp_path / "t.csv").write_text("t;x;y;yaw\n0,5;1,25;-2;0\n1,5;2,25;-2;0,5\n")
    found = read_trajectory(tmp_path / "t.csv")
    assert found.stamps.tolist() == [0.5, 1.5]
    np.testing.assert_allclose(found.poses, [[1.25, -2, 0], [2.25, -2, 0.5]], atol=1e-15)


@pytest.mark.parametrize(
    ("quaternion", "direction", "oriented"),
    [
        ("0 0 0 1", (1, 0, 0), True),  # straight ahead
        ("0 0 0 1", (0, 0, 1), True),  # as a camera
        ("0 0 0 1", (0, 1, 0), False),
        ("0 0 0.70710678 0.70710678", (0, 1, 0), True),
        ("0 0 0 1", (0, 0.001, 0), True),  # stands
        ("0 0 0 0", (1, 0, 0), False),
    ],
)
def test_an_orientation_that_never_changes(tmp_path: Path, quaternion: str, direction, oriented: bool) -> None:
    rows = (f"{k / 10} {' '.join(str(0.1 * k * part) for part in direction)} {quaternion}" for k in range(20))
    (tmp_path / "t").write_text("\n".join(rows) + "\n")
    found = read_trajectory(tmp_path / "t")
    assert found.oriented == oriented
    assert ("no-orientation" in [issue.code for issue in found.warnings]) != oriented


@pytest.mark.parametrize(
    ("period", "count", "how", "told"),
    [
        (1.826, 50, "{0:.0f}.{1}", True),
        (1.013, 85, "{0:.0f}.{1}", True),
        (1.826, 250, "{2!r}", True),
        (1.826, 50, "{3:.9f}", False),
        (1.826, 50, "{3:.6f}", False),
        (1.013, 85, "{3!r}", False),
        (1.013, 85, "{3:.15g}", False),
        (1.013, 85, "{3:#.15g}", False),
        (1.826, 250, "{3:.2f}", False),
    ],
)
def test_stamps_without_leading_zeros_are_told(tmp_path: Path, period: float, count: int, how: str, told: bool) -> None:
    """Of few poses by their digits, of more by the stamps alone."""
    lines = []
    for k in range(count):
        stamp = 95.116 + period * k
        nanoseconds = round(stamp % 1 * 1e9) // 1000 * 1000
        wrong = float(f"{stamp // 1:.0f}.{nanoseconds}")
        lines.append(f"{how.format(stamp // 1, nanoseconds, wrong, stamp)} {k} 0 0 0 0 0 1\n")
    path = tmp_path / "some.tum"
    path.write_text("".join(lines))
    assert [issue.code for issue in read_trajectory(path).warnings] == ["stamps-jitter"] * told


def test_some_poses_keep_their_places_in_space() -> None:
    space = Space(np.arange(12.0).reshape(4, 3), np.tile(np.eye(3), (4, 1, 1)))
    part = Trajectory(np.arange(4.0), np.zeros((4, 3)), space=space).take(np.array([1, 3]))
    assert part.stamps.tolist() == [1, 3]
    assert part.space is not None
    np.testing.assert_array_equal(part.space.positions, space.positions[[1, 3]])
