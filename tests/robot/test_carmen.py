"""CARMEN logs: the lines, the rules, what is broken, and the real logs."""

import gzip
import math
from collections.abc import Iterable
from pathlib import Path

import numpy as np
import pytest
from issues import counted
from issues import messages as all_messages
from robot_logs import flaser, odom, robotlaser, write_log

from moteslam.errors import InputError, OutputError
from moteslam.robot import se2
from moteslam.robot.formats import lines as text_lines
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.carmen import is_carmen, read_carmen
from moteslam.robot.formats.streams import MAX_DROPPED
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platform import LidarSpec, Platform
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.values import Issue

GOOD = [flaser([1.0, 2.0, 3.0], stamp=100.0 + k, robot=(0.1 * k, 0, 0)) for k in range(8)]


def messages(issues: Iterable[Issue]) -> tuple[str, ...]:
    """The line of each, but that of the angles assumed: the scans below have a beam or three."""
    return all_messages(issue for issue in issues if issue.code != "assumed-angles")


@pytest.mark.parametrize("name", ["x.log", "x.clf", "x.log.gz", "x", "x.gz", "x.txt"])
@pytest.mark.parametrize("packed", [False, True])
def test_the_format_is_known_by_content_not_name(tmp_path: Path, name: str, packed: bool) -> None:
    path = write_log(tmp_path / name, ["# a comment", *GOOD], packed=packed)
    assert len(open_recording(path).lidar) == 8


@pytest.mark.parametrize(("beams", "step"), [(180, 1.0), (181, 1.0), (360, 0.5), (361, 0.5), (91, 2.0), (1, 180.0)])
def test_the_beams_of_flaser(tmp_path: Path, beams: int, step: float) -> None:
    lidar = read_carmen(write_log(tmp_path / "x.log", [flaser([5.0] * beams)])).lidar
    assert lidar.angle_min == -math.pi / 2
    assert lidar.angle_increment == pytest.approx(math.radians(step), rel=1e-15)
    assert lidar.ranges.shape == (1, beams)


def test_robotlaser_tells_its_own_angles_limit_and_poses(tmp_path: Path) -> None:
    line = robotlaser([1.0, 29.9, 30.0], stamp=7.5, angle_min=-1.0, step=0.25, limit=30.0, remissions=[8, 9])
    recording = read_carmen(write_log(tmp_path / "x.log", [line]))
    lidar = recording.lidar
    assert (lidar.angle_min, lidar.angle_increment, lidar.range_max) == (-1.0, 0.25, 30.0)
    np.testing.assert_array_equal(lidar.ranges, np.float32([[1.0, 29.9, np.inf]]))
    np.testing.assert_array_equal(lidar.stamps, [7.5])
    np.testing.assert_array_equal(lidar.odometry, [[1.0, 2.0, 0.5]])


def test_the_mount_comes_from_the_caller_the_parameters_or_the_poses(tmp_path: Path) -> None:
    ahead = [flaser([1.0], laser=(k + 0.2, 1.0, 0.0), robot=(k, 1.0, 0.0), stamp=k) for k in range(5)]
    params = [
        "PARAM robot_frontlaser_offset 0.3 host 0",
        "PARAM robot_frontlaser_side_offset 0.1 host 0",
        "PARAM robot_length 0.7 host 0",
        "PARAM robot_name frank host 0",
    ]
    stated = read_carmen(write_log(tmp_path / "given.log", [*params, *ahead])).platform
    assert stated.lidar.pose == (0.3, 0.1, 0.0)
    assert stated.length == 0.7
    assert read_carmen(write_log(tmp_path / "poses.log", ahead)).platform.lidar.pose == (0.2, 0.0, 0.0)
    corrected = [flaser([1.0], laser=(k * 1.1, 1.0, 0.0), robot=(k, 1.0, 0.0), stamp=k) for k in range(5)]
    assert read_carmen(write_log(tmp_path / "moved.log", corrected)).platform.lidar.pose == (0, 0, 0)
    (tmp_path / "turned.toml").write_text("[lidar]\nyaw = 0.2\n")
    assert read_carmen(tmp_path / "given.log", platform=tmp_path / "turned.toml").platform.lidar.pose == (0.3, 0.1, 0.2)
    mine = Platform(lidar=LidarSpec(x=-1, time_increment=1e-3))
    recording = read_carmen(tmp_path / "given.log", platform=mine)
    assert recording.platform == mine
    assert recording.lidar.time_increment == 1e-3


@pytest.mark.parametrize("exchanged", [True, False])
@pytest.mark.parametrize("way", [1.0, -1.0])
def test_poses_of_robot_and_laser_that_are_exchanged_are_put_right_by_the_odometry(
    tmp_path: Path, exchanged: bool, way: float
) -> None:
    lines = []
    for k in range(20):
        robot, laser = (way * 0.3 * k, 1.0, 0.0), (way * 0.3 * k + 0.2, 1.0, 0.0)
        lines += [odom(robot, k - 0.05), odom(robot, k + 0.05)]
        robot, laser = (laser, robot) if exchanged else (robot, laser)
        lines.append(flaser([1.0], laser=laser, robot=robot, stamp=k))
    recording = read_carmen(write_log(tmp_path / "x.log", lines))
    assert ("exchanged-poses" in [issue.code for issue in recording.warnings]) == exchanged
    assert recording.platform.lidar.pose == pytest.approx((0.2, 0.0, 0.0))
    np.testing.assert_allclose(recording.lidar.odometry[:, 0], way * 0.3 * np.arange(20))


@pytest.mark.parametrize("exchanged", [True, False])
def test_poses_of_robot_and_laser_that_are_exchanged_are_put_right_by_the_way_in_which_wheels_roll(
    tmp_path: Path, exchanged: bool
) -> None:
    robots = se2.accumulate(np.tile([0.2 * np.cos(0.05), 0.2 * np.sin(0.05), 0.1], (100, 1)))
    poses = robots, se2.compose(robots, np.array([0.1, 0.0, 0.0]))
    lines = [
        flaser([1.0], robot=tuple(robot), laser=tuple(laser), stamp=k)
        for k, (robot, laser) in enumerate(zip(*poses[:: -1 if exchanged else 1], strict=True))
    ]
    recording = read_carmen(write_log(tmp_path / "x.log", lines))
    assert ("exchanged-poses" in [issue.code for issue in recording.warnings]) == exchanged
    assert recording.platform.lidar.pose == pytest.approx((0.1, 0.0, 0.0), abs=1e-4)
    np.testing.assert_allclose(recording.lidar.odometry[:, :2], robots[:, :2], atol=1e-4)


def test_the_stamp_is_the_ipc_one_or_the_loggers_where_all_are_zero(tmp_path: Path) -> None:
    lines = [flaser([1.0], stamp=0.0, logged=5.0 + k) for k in range(3)]
    np.testing.assert_array_equal(read_carmen(write_log(tmp_path / "x.log", lines)).lidar.stamps, [5, 6, 7])
    lines = [flaser([1.0], stamp=float(k), logged=50.0) for k in range(3)]
    np.testing.assert_array_equal(read_carmen(write_log(tmp_path / "y.log", lines)).lidar.stamps, [0, 1, 2])
    short = [" ".join(line.split()[:-2]) for line in GOOD]  # without host and logger's stamp
    np.testing.assert_array_equal(read_carmen(write_log(tmp_path / "z.log", short)).lidar.stamps, 100.0 + np.arange(8))


@pytest.mark.parametrize(
    ("by", "sequence"),
    [("lines", [0, 2, 3, 1, 4]), ("stamps", None)],
)
def test_the_poses_logged_with_the_scans_tell_whether_file_or_stamps_have_the_right_order(
    tmp_path: Path, by: str, sequence: list[int] | None
) -> None:
    stamps = [0.0, 2.0, 1.0, 1.0, 3.0]
    metres = range(5) if by == "lines" else np.argsort(np.argsort(stamps, kind="stable"))
    lines = [flaser([1.0], stamp=stamp, robot=(x, 0, 0)) for stamp, x in zip(stamps, metres, strict=True)]
    recording = read_carmen(write_log(tmp_path / "x.log", lines))
    found = recording.lidar.sequence
    assert (None if found is None else found.tolist()) == sequence
    codes = [warning.code for warning in recording.warnings]
    assert ("stamps-out-of-order" in codes) == (sequence is not None)


BROKEN = {
    "cut in the ranges": " ".join(GOOD[0].split()[:4]),
    "a word for a number": "FLASER x 1 2 3",
    "too many beams declared": GOOD[0].replace("FLASER 3", "FLASER 999999999"),
    "a pose that is NaN": flaser([1, 2, 3], robot=(math.nan, 0, 0)),
    "odometry off the globe": "ODOM 0 -2e7 0 0 0 0 1 host 1",
    "a stamp in milliseconds": flaser([1, 2, 3], stamp=1.2e12),
    "a word for a range": GOOD[0].replace("2.0", "two"),
    "no angles": robotlaser([1.0], step=0.0),
    "escape codes": "FLASER 1 \x1b[31m" + "x" * 999 + GOOD[0][9:],
    "what a file system leaves of a log when the power is lost": "\0" * 1_000_000,
}


@pytest.mark.parametrize("line", BROKEN.values(), ids=BROKEN.keys())
def test_a_broken_line_is_dropped_counted_and_named(tmp_path: Path, line: str) -> None:
    recording = read_carmen(write_log(tmp_path / "x.log", [*GOOD[:4], line, *GOOD[4:], line]))
    assert len(recording.lidar) == 8
    (warning,) = messages(recording.warnings)
    assert warning.startswith("x.log: 2 broken lines dropped, the first is line 5: ")
    assert warning.isprintable()
    assert len(warning) < 400


@pytest.mark.parametrize("whole", [0, 8])
def test_a_log_with_much_broken_is_refused(tmp_path: Path, whole: int) -> None:
    path = write_log(tmp_path / "x.log", [*GOOD[:whole], *["FLASER 3 1 2"] * (MAX_DROPPED + 1)])
    with pytest.raises(InputError, match=rf"x\.log:{whole + 1}: 4 words"):
        read_carmen(path)


def test_what_ranges_mean(tmp_path: Path) -> None:
    lines = [*GOOD[:7], flaser([math.inf, -1.0, 0.0], stamp=200.0)]
    recording = read_carmen(write_log(tmp_path / "x.log", lines))
    np.testing.assert_array_equal(recording.lidar.ranges[-1], np.float32([np.inf, np.nan, np.nan]))
    assert messages(recording.warnings) == ("x.log: FLASER: 1 range in 1 scan left out, NaN or negative",)


@pytest.mark.parametrize("damage", ["cut short", "damaged"])
def test_a_damaged_gzip_gives_what_came_before(tmp_path: Path, damage: str) -> None:
    rng = np.random.default_rng(0)
    lines = [flaser(rng.uniform(1, 5, 180).round(2).tolist(), stamp=k) for k in range(2000)]
    path = write_log(tmp_path / "x.log.gz", lines, packed=True)
    data = bytearray(path.read_bytes())
    data[-6] ^= 0xFF  # the checksum
    path.write_bytes(data if damage == "damaged" else data[: len(data) // 2])
    recording = read_carmen(path)
    assert len(recording.lidar) == pytest.approx(1950 if damage == "damaged" else 1000, abs=50)
    assert messages(recording.warnings) == (f"x.log.gz: the gzip data is {damage}; what came before is used",)


@pytest.mark.parametrize(("what", "most"), [("MAX_TEXT", 60_000), ("MAX_LINES", 10_000), ("MAX_LINE", 20)])
def test_a_gzip_bomb_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str, most: int) -> None:
    path = tmp_path / "x.log.gz"
    path.write_bytes(gzip.compress(b"FLASER\n" * 30_000 + b"0" * 1000))
    monkeypatch.setattr(text_lines, what, most)
    with pytest.raises(InputError, match="expected a log"):
        read_carmen(path)


NOTHING = gzip.compress(b"", mtime=0)  # with the time in it, no two test processes would name their tests alike


@pytest.mark.parametrize("content", [b"\x1f\x8b", NOTHING[:8], NOTHING, b"hello\n", b"# x"])
def test_what_is_no_log_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "x.log"
    path.write_bytes(content)
    assert not is_carmen(path)
    with pytest.raises(InputError, match="expected a CARMEN log"):
        read_carmen(path)


def test_writing_interpolates_the_odometry_and_needs_one(tmp_path: Path) -> None:
    lidar = LidarStream(np.array([0.5]), np.ones((1, 3), np.float32), -1.0, 1.0, 0.0, 30.0)
    odometry = OdometryStream(np.array([0.0, 1.0]), np.array([[0.0, 0, 0], [2.0, 0, 0]]))
    write_carmen(tmp_path / "x.log", Recording("x", Platform(), lidar=lidar, odometry=odometry))
    logged = read_carmen(tmp_path / "x.log").lidar.odometry
    np.testing.assert_array_equal(logged, [[1.0, 0, 0]])
    for nothing in (Recording("x", Platform(), lidar=lidar), Recording("x", Platform())):
        with pytest.raises(InputError, match="odometry: no odometry poses"):
            write_carmen(tmp_path / "y.log", nothing)
    with pytest.raises(OutputError, match="cannot be written"):
        write_carmen(tmp_path / "x.log" / "y.log", Recording("x", Platform(), lidar=lidar, odometry=odometry))


@pytest.mark.parametrize(
    ("path", "shape", "no_return", "equal"),
    [
        ("intel/intel_raw_part.log.gz", (5505, 180), 0.0489, 304),
        ("intel/intel_key_scans.log.gz", (910, 180), 0.0255, 0),
        ("key_scans/freiburg-101.log.gz", (292, 360), 0.1194, 0),
    ],
)
def test_real_logs(data_folder: Path, path: str, shape: tuple[int, int], no_return: float, equal: int) -> None:
    recording = open_recording(data_folder / path)
    lidar = recording.lidar
    assert lidar.ranges.shape == shape
    assert np.isinf(lidar.ranges).mean() == pytest.approx(no_return, abs=5e-5)
    assert not np.isnan(lidar.ranges).any()
    assert lidar.ranges[np.isfinite(lidar.ranges)].max() < 80
    assert (np.diff(lidar.stamps) == 0).sum() == equal
    np.testing.assert_array_equal(recording.odometry.poses, lidar.odometry)
    assert recording.platform.lidar.pose == (0, 0, 0)
    assert messages(recording.warnings) == ()


RAW = ["{} 0 -1.5 3.0 0.5 30.0 0.01 0 3 1.0 2.0 {} 0 {} host 0.5".format("{}", k + 3, 10.0 + k) for k in range(8)]


def test_raw_scans_are_read_where_no_scan_states_a_pose(tmp_path: Path) -> None:
    lines = [odom((0.5, 0, 0), 9.0), *(line.format("RAWLASER1") for line in RAW), odom((1.5, 0, 0), 19.0)]
    recording = open_recording(write_log(tmp_path / "x.log", lines))
    lidar = recording.lidar
    assert (lidar.angle_min, lidar.angle_increment, lidar.range_max) == (-1.5, 0.5, 30.0)
    np.testing.assert_array_equal(lidar.stamps, np.arange(10.0, 18.0))
    np.testing.assert_array_equal(lidar.ranges[:, 2], np.arange(3, 11, dtype=np.float32))
    assert lidar.odometry is None
    assert recording.odometry is not None
    assert recording.platform.lidar.pose == (0, 0, 0)
    assert messages(recording.warnings) == ()


REAR = [GOOD[0].replace("FLASER", "RLASER"), robotlaser([1.0]).replace("ROBOTLASER1", "ROBOTLASER2")]
RAW1, RAW2, RAW5 = ([line.format(f"RAWLASER{k}") for line in RAW] for k in (1, 2, 5))


@pytest.mark.parametrize(
    ("lines", "scans", "beams", "aside"),
    [
        ([*GOOD, flaser([1.0] * 5, stamp=200.0)], 8, 3, 1),
        ([line for k in range(3) for line in (flaser([1.0] * 2, stamp=k), robotlaser([2.0], stamp=k))], 3, 1, 1),
        ([*RAW5, *RAW2[:3]], 8, 3, 1),  # the more frequent of two
        ([*GOOD, *REAR, *REAR], 8, 3, 2),
        ([*RAW1[:4], GOOD[0], *RAW1[4:]], 1, 3, 0),  # raw ones of the same scans
        ([*RAW1[:4], robotlaser([1.0] * 3), *RAW1[4:]], 1, 3, 0),
    ],
    ids=["other beams", "two kinds", "two raw lasers", "rear", "raw beside FLASER", "raw beside ROBOTLASER1"],
)
def test_scans_that_are_none_of_the_lidars_are_left_aside_and_told(
    tmp_path: Path, lines: list[str], scans: int, beams: int, aside: int
) -> None:
    recording = read_carmen(write_log(tmp_path / "x.log", lines))
    assert recording.lidar.ranges.shape == (scans, beams)
    codes = [issue.code for issue in recording.warnings if issue.code != "assumed-angles"]
    assert codes == ["other-scans"] * aside


def test_flaser_lines_without_stamps(tmp_path: Path) -> None:
    short = [" ".join(line.split()[:-3]) for line in GOOD]
    recording = read_carmen(write_log(tmp_path / "x.log", [*short, odom((0, 0, 0), 1e9)]))
    lidar = recording.lidar
    np.testing.assert_array_equal(lidar.stamps, np.arange(8.0))
    np.testing.assert_allclose(lidar.odometry[:, 0], 0.1 * np.arange(8))
    assert recording.odometry is None
    assert counted(recording.warnings)[:2] == [("no-stamps", 1), ("other-clock", 1)]


@pytest.mark.parametrize(("beams", "angles", "expected"), [(228, "", True), (181, "", False), (228, "given", False)])
def test_it_is_said_that_flaser_lines_state_no_angles(tmp_path: Path, beams: int, angles: str, expected: bool) -> None:
    path = write_log(tmp_path / "x.log", [flaser([1.0] * beams, stamp=float(k)) for k in range(9)])
    (tmp_path / "robot.toml").write_text("[lidar]\nangle_min = -2.1\nangle_increment = 0.0184\n")
    recording = read_carmen(path, platform=tmp_path / "robot.toml" if angles else None)
    found = [issue.message for issue in recording.warnings if issue.code == "assumed-angles"]
    assert len(found) == expected
    assert all("228 beams are assumed to span 180 degrees" in each for each in found)


@pytest.mark.parametrize(("beams", "turn", "expected"), [(360, 1, True), (361, 1, True), (361, 0.5, False)])
def test_scans_that_close_are_told_to_be_of_a_full_circle(
    tmp_path: Path, beams: int, turn: float, expected: bool
) -> None:
    bearings = 2 * np.pi * turn * np.arange(beams) / 360
    scans = [(4 + 2 * np.sin(bearings + 0.3 * k) + 0.5 * np.sin(3 * bearings)).tolist() for k in range(40)]
    path = write_log(tmp_path / "x.log", [flaser(scan, stamp=float(k)) for k, scan in enumerate(scans)])
    found = [issue.message for issue in read_carmen(path).warnings if issue.code == "assumed-angles"]
    assert len(found) == expected
    assert all("full circle, -3.14159 and 0.0174533" in each for each in found)
