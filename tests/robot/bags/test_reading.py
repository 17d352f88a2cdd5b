"""Bags of every kind, read; wheels as joints, and real bags."""

import math
from pathlib import Path

import made_bags
import numpy as np
import pytest
from made_bags import START, codes, drive, imu, make_bag, odometry, placed, rolled, scan
from refusals import refusal

from moteslam import open_recording
from moteslam.errors import InputError
from moteslam.robot.formats import format_of
from moteslam.robot.formats.bags.motion import angle_of_count
from moteslam.robot.formats.bags.write import Event, header
from moteslam.robot.platforms import bundled_platform
from moteslam.robot.recording import ChunkedRanges
from moteslam.robot.wheel_odometry import wheel_path


@pytest.mark.parametrize("kind", made_bags.KINDS)
def test_every_kind_of_bag_gives_the_same_streams(tmp_path: Path, kind: str) -> None:
    recording = open_recording(make_bag(tmp_path, drive(), kind))
    assert recording.warnings == ()
    np.testing.assert_array_equal(recording.lidar.stamps, 1.6e9 + 0.1 * np.arange(20))
    expected = (np.linspace(1.0, 5.0, 19) + 0.01 * np.arange(20)[:, None]).astype(np.float32)
    np.testing.assert_array_equal(recording.lidar.ranges[:], expected)
    assert recording.lidar.angle_min == pytest.approx(-math.pi / 2)
    assert recording.lidar.angle_increment == pytest.approx(math.pi / 18)
    assert (recording.lidar.range_min, recording.lidar.range_max) == pytest.approx((0.1, 10.0))
    np.testing.assert_allclose(recording.odometry.poses[:, 0], 0.1 * np.arange(20), atol=1e-15)
    np.testing.assert_array_equal(recording.imu.angular_velocity[:, 2], 0.01 * np.arange(20))
    np.testing.assert_array_equal(recording.imu.linear_acceleration_g, np.tile([0.0, 0.0, 1.0], (20, 1)))
    assert recording.platform.lidar.pose == (0.2, 0.1, 0.0)
    assert recording.platform.lidar.z == 0.3


def test_other_sqlite_files_and_folders_are_not_bags(tmp_path: Path) -> None:
    import sqlite3

    path = tmp_path / "x.db3"
    connection = sqlite3.connect(path)
    connection.execute("CREATE TABLE messages (id INTEGER)")
    connection.commit()
    connection.close()
    with pytest.raises(InputError, match="not a recording known here"):
        format_of(path)
    (tmp_path / "metadata.yaml").write_text("other: 1\n")
    with pytest.raises(InputError, match="not a recording known here"):
        format_of(tmp_path)


def test_ranges_are_read_from_the_bag_again(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive())
    lidar = open_recording(path).lidar
    assert isinstance(lidar.ranges, ChunkedRanges)
    path.unlink()
    with pytest.raises(InputError, match=r"made\.bag: .*No such file"):
        lidar.ranges[0]


def test_ranges_mean_what_rep_117_says(tmp_path: Path) -> None:
    raw = [1.0, np.inf, -np.inf, np.nan, 0.0, 0.05, 10.0, 12.0, 9.9]
    lidar = open_recording(make_bag(tmp_path, [scan(0, raw), scan(0.1, raw)])).lidar
    expected = np.array([1.0, np.inf, np.nan, np.nan, np.nan, np.nan, np.inf, np.inf, 9.9], np.float32)
    np.testing.assert_array_equal(lidar.ranges[0], expected)


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_the_first_echo_of_a_beam_counts(tmp_path: Path, kind: str) -> None:
    one = scan(0, [0.0])
    echoes = [[2.0], [3.0, 4.0], [], [5.0]]
    ranges = [{"echoes": np.array(values, np.float32)} for values in echoes]
    values = {**one.values, "ranges": ranges, "intensities": [], "angle_increment": math.pi / 3}
    event = Event(one.time, "/echoes", "sensor_msgs/MultiEchoLaserScan", values)
    lidar = open_recording(make_bag(tmp_path, [event], kind)).lidar
    np.testing.assert_array_equal(lidar.ranges[0], np.array([2.0, 3.0, np.inf, 5.0], np.float32))


def test_headers_without_stamps_give_way_to_the_time_of_reception(tmp_path: Path) -> None:
    events = [scan(0.1 * index - 1.6e9, [1.0, 2.0]) for index in range(5)]
    for event in events:
        event.values["header"] = header(0, "laser")
    received = [START + index * 100_000_000 for index in range(5)]
    recording = open_recording(make_bag(tmp_path, events, received=received))
    np.testing.assert_array_equal(recording.lidar.stamps, 1.6e9 + 0.1 * np.arange(5))
    assert codes(recording) == ["no-header-stamps", "no-mount"]


def test_a_lidar_that_hangs_upside_down_turns_the_other_way(tmp_path: Path) -> None:
    mount = placed(0, "base_link", "laser", (0.1, 0.0, 0.5), turn=rolled(math.pi, 0.3))
    events = [mount, scan(0, [1.0, 2.0, 3.0], angle_min=-0.2, angle_max=1.4, angle_increment=0.8)]
    recording = open_recording(make_bag(tmp_path, events))
    assert recording.warnings == ()
    np.testing.assert_allclose(recording.lidar.angles, [0.2, -0.6, -1.4], atol=1e-6)
    np.testing.assert_array_equal(recording.lidar.ranges[0], np.array([1.0, 2.0, 3.0], np.float32))
    assert recording.platform.lidar.pose == pytest.approx((0.1, 0.0, 0.3))


UNTURNED = placed(0, "base_link", "laser", (0.1, 0.0, 0.0), turn=dict.fromkeys("xyzw", 0.0))
TREE = [
    placed(0, "base_link", "mast", (1.0, 0.0, 0.0), turn=rolled(0, math.pi / 2)),
    placed(0, "mast", "laser", (0.5, 0.0, 0.0)),
    odometry(0, (0, 0, 0), child="base_footprint"),
    placed(0, "base_footprint", "base_link", (0.1, 0.0, 0.0)),
]
TWO_PARENTS = [
    *(placed(index, "camera", "laser", (9.0, 0.0, 0.0)) for index in range(5)),
    placed(0, "base_link", "laser", (0.2, 0.0, 0.0)),
    placed(0, "odom", "base_link"),
]


def moved(topic: str) -> list[Event]:
    return [placed(index, "base_link", "laser", (0.1 + 0.2 * index, 0.0, 0.0), topic=topic) for index in range(2)]


@pytest.mark.parametrize(
    ("events", "pose", "code"),
    [
        ([], (0.0, 0.0, 0.0), "no-mount"),
        ([placed(0, "base_link", "laser", turn=rolled(0.01))], (0.0, 0.0, 0.0), None),
        ([placed(0, "base_link", "laser", turn=rolled(0.1))], (0.0, 0.0, 0.0), "lidar-tilted"),
        ([UNTURNED], (0.1, 0.0, 0.0), "mount-unturned"),
        (moved("/tf_static"), (0.3, 0.0, 0.0), "mount-corrected"),
        (moved("/tf"), (0.1, 0.0, 0.0), "mount-moves"),
        (TREE, (1.1, 0.5, math.pi / 2), None),
        (TWO_PARENTS, (0.2, 0.0, 0.0), None),
    ],
)
def test_where_the_lidar_stands(
    tmp_path: Path, events: list[Event], pose: tuple[float, float, float], code: str | None
) -> None:
    recording = open_recording(make_bag(tmp_path, [*events, scan(0, [1.0, 2.0])]))
    assert recording.platform.lidar.pose == pytest.approx(pose)
    assert codes(recording) == ([code] if code else [])


def test_transforms_are_the_odometry_where_there_is_no_other(tmp_path: Path) -> None:
    events = []
    for index in range(4):
        events.append(
            placed(index, "/odom_combined", "/base_link", (0.5 * index, 0.0, 0.0), turn=rolled(0, 0.1 * index))
        )
        events.append(scan(index, [1.0, 2.0], frame="base_link"))
    recording = open_recording(make_bag(tmp_path, events))
    expected = [[0.5 * index, 0.0, 0.1 * index] for index in range(4)]
    np.testing.assert_allclose(recording.odometry.poses, expected, atol=1e-12)
    np.testing.assert_array_equal(recording.odometry.stamps, 1.6e9 + np.arange(4))


def test_a_given_mount_takes_the_place_of_a_missing_one(tmp_path: Path) -> None:
    (tmp_path / "b").mkdir()
    path = make_bag(tmp_path, [scan(0, [1.0, 2.0])])
    assert codes(open_recording(path)) == ["no-mount"]
    robot = tmp_path / "platform.toml"
    robot.write_text("[lidar]\nx = 0.4\ny = 0.0\nyaw = 1.0\n")
    recording = open_recording(path, platform=robot)
    assert recording.warnings == ()
    assert recording.platform.lidar.pose == (0.4, 0.0, 1.0)
    tilted = make_bag(tmp_path / "b", [placed(0, "base_link", "laser", turn=rolled(1.2)), scan(0, [1.0, 2.0])])
    with pytest.raises(InputError, match=r"/scan: laser is tilted by 69 degrees in base_link"):
        open_recording(tilted)
    assert open_recording(tilted, platform=robot).platform.lidar.pose == (0.4, 0.0, 1.0)


@pytest.mark.parametrize(("other", "count", "beams"), [("/back", 4, 2), ("/laser", 8, 3), ("/vertical_laser", 9, 2)])
def test_of_several_lidars_the_one_with_most_scans_is_read(tmp_path: Path, other: str, count: int, beams: int) -> None:
    first = "/vertical" if other == "/laser" else "/front"
    events = [scan(0.1 * index, [1.0, 2.0], topic=first) for index in range(9)]
    events += [scan(0.1 * index, [3.0, 4.0, 5.0], topic=other) for index in range(count)]
    recording = open_recording(make_bag(tmp_path, events))
    assert recording.lidar.ranges.shape[1] == beams
    assert "topics-left" in codes(recording)


@pytest.mark.parametrize(
    ("topics", "field"),
    [
        ({"lidar": ("/nowhere",)}, "topics.lidar"),
        ({"imu": ("/scan",)}, "topics.imu"),
        ({"imu": ("/imu", "/imu2")}, "topics.imu"),
        ({"radar": ("/scan",)}, "topics"),
        ({"encoders": ("/joint_states",)}, "topics.encoders"),
    ],
)
def test_topics_that_are_not_there_are_refused(tmp_path: Path, topics: dict[str, tuple[str, ...]], field: str) -> None:
    with refusal(InputError, "expected", field=field):
        open_recording(make_bag(tmp_path, drive(3)), topics=topics)


def test_readings_of_a_turned_imu_are_turned_into_the_robots_axes(tmp_path: Path) -> None:
    events = [placed(0, "base_link", "imu", turn=rolled(math.pi)), imu(0, (0.1, 0.2, 0.3)), imu(0.1, (0.1, 0.2, 0.3))]
    recording = open_recording(make_bag(tmp_path, events))
    np.testing.assert_allclose(recording.imu.angular_velocity[0], [0.1, -0.2, -0.3], atol=1e-12)
    np.testing.assert_allclose(recording.imu.linear_acceleration_g[0], [0.0, 0.0, -1.0], atol=1e-12)
    assert codes(recording) == ["imu-turned"]


@pytest.mark.parametrize(
    ("sweep", "between", "used"),
    [
        (0.02, (0.02, 0.02), True),
        (0.0206, (0.02, 0.02), True),
        (0.026, (0.02, 0.02), False),
        (0.0206, (0.005, 0.035), True),  # scans that arrive in pairs
        (0.0206, (0.035, 0.005), True),
        (0.026, (0.035, 0.005), False),
        (2.25, (0.02, 0.02), False),
    ],
)
def test_a_time_between_beams_that_cannot_be_is_not_used(
    tmp_path: Path, sweep: float, between: tuple[float, float], used: bool
) -> None:
    stamps, step = np.cumsum([0.0, *between * 3, between[0]]), sweep / 9
    recording = open_recording(make_bag(tmp_path, [scan(at, np.ones(10), time_increment=step) for at in stamps]))
    assert recording.platform.lidar.time_increment == pytest.approx(step if used else 0.0)
    assert ("time-increment" in codes(recording)) != used


@pytest.mark.parametrize("range_max", [0.0, math.nan, math.inf])
def test_a_limit_that_is_none_is_taken_from_the_ranges(tmp_path: Path, range_max: float) -> None:
    recording = open_recording(make_bag(tmp_path, [scan(0, [1.0, 2.0], range_max=range_max)]))
    assert recording.lidar.range_max == 80.0
    assert "range-max" in codes(recording)


@pytest.mark.parametrize(
    ("event", "field"),
    [
        (scan(0, [1.0, 2.0], angle_increment=0.0, angle_max=-math.pi / 2), "/scan"),
        (scan(0, np.ones(10), angle_increment=1.0), "/scan: angle_increment"),
        (scan(0, [1.0], angle_min=math.nan), "/scan"),
        (scan(0, []), "/scan"),
        (scan(0, [1.0, 2.0], angle_min=100.0, angle_max=103.0), "/scan"),
        (placed(0, "map", "world"), None),
        (odometry(0, (math.nan, 0, 0)), "/odom"),
        (odometry(0, (1e8, 0, 0)), "/odom"),
    ],
)
def test_messages_of_no_robot_are_refused(tmp_path: Path, event: Event, field: str | None) -> None:
    with refusal(InputError, field=field):
        open_recording(make_bag(tmp_path, [event]))


def test_broken_transforms_are_counted(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(3))
    content = path.read_bytes()
    odom = bytes([1, 0, 0, 0]) + bytes(4)
    assert odom in content
    path.write_bytes(content.replace(odom, bytes([9, 0, 0, 0]) + bytes(4), 1))
    assert codes(open_recording(path)) == ["broken-messages"]


TURTLEBOT = bundled_platform("turtlebot3")
STEP = angle_of_count(TURTLEBOT.wheels)


def joints(time: float, names: list[str], angles: list[float]) -> Event:
    stamp = START + round(time * 1e9)
    nothing = np.empty(0)
    values = {"header": header(stamp, ""), "name": names, "position": np.array(angles), "velocity": nothing}
    return Event(stamp, "/joint_states", "sensor_msgs/JointState", {**values, "effort": nothing})


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_wheels_are_read_where_they_are_named(tmp_path: Path, kind: str) -> None:
    names = ["wheel_right_joint", "arm", "wheel_left_joint"]
    moves = [joints(0.1 * i, names, [(100 + 3 * i) * STEP, 9.0, (2 * i + 10) * STEP]) for i in range(5)]
    path = make_bag(tmp_path, [*drive(5), *moves], kind)
    assert open_recording(path, platform="turtlebot3").encoders is None
    encoders = open_recording(path, platform="turtlebot3", topics={"encoders": ("/joint_states",)}).encoders
    np.testing.assert_array_equal(encoders.counts[1:], np.tile([3, 2, 3, 2], (4, 1)))
    np.testing.assert_array_equal(encoders.counts[0], [100, 10, 100, 10])  # less than 1 m: they stood at 0 before


def test_wheels_that_could_be_the_odometry_are_named(tmp_path: Path) -> None:
    scans = [event for event in drive(5) if event.topic in ("/scan", "/tf_static")]
    path = make_bag(tmp_path, [*scans, *(joints(0.1 * i, ["left_wheel", "right_wheel"], [i, i]) for i in range(5))])
    (issue,) = open_recording(path, platform="turtlebot3").warnings
    assert issue.code == "no-odometry"
    assert "/joint_states: left out: --topics encoders=TOPIC" in issue.message


def test_wheels_that_had_gone_far_before_count_from_the_first_reading(tmp_path: Path) -> None:
    moves = [joints(0.1 * i, ["left_wheel", "right_wheel"], [1e6 * STEP, (1e6 + i) * STEP]) for i in range(5)]
    recording = open_recording(
        make_bag(tmp_path, [*drive(5), *moves]), platform="turtlebot3", topics={"encoders": ("/joint_states",)}
    )
    np.testing.assert_array_equal(recording.encoders.counts[0], [0, 0, 0, 0])
    np.testing.assert_array_equal(recording.encoders.counts[1:], np.tile([1, 0, 1, 0], (4, 1)))


@pytest.mark.parametrize(
    ("platform", "names", "problem"),
    [
        (None, ["left_wheel", "right_wheel"], r"/joint_states: joints of wheels, expected a platform with \[wheels\]"),
        ("turtlebot3", ["arm", "gripper"], "/joint_states: .*no wheels .*: arm, gripper"),
    ],
)
def test_joints_that_are_no_wheels_are_refused(
    tmp_path: Path, platform: str | None, names: list[str], problem: str
) -> None:
    path = make_bag(tmp_path, [*drive(5), joints(0, names, [0.0, 0.0])])
    with pytest.raises(InputError, match=problem):
        open_recording(path, platform=platform, topics={"encoders": ("/joint_states",)})


def test_a_turtlebots_bag(data_folder: Path) -> None:
    path = data_folder / "bags" / "fuse_turtlebot3.bag"
    recording = open_recording(path, platform="turtlebot3", topics={"encoders": ("/joint_states",)})
    assert recording.encoders is not None
    assert recording.lidar.ranges.shape == (457, 360)
    assert len(recording.odometry) == 2741
    # the wheels drove the same way that the odometry says
    path_length = np.hypot(*np.diff(wheel_path(recording)[:, :2], axis=0).T).sum()
    assert path_length == pytest.approx(np.hypot(*np.diff(recording.odometry.poses[:, :2], axis=0).T).sum(), rel=0.05)


@pytest.mark.slow
def test_a_museums_bag(data_folder: Path) -> None:
    (path,) = (data_folder / "bags").glob("cartographer_b0*.bag")
    recording = open_recording(path)
    assert recording.odometry is None
    assert recording.lidar.ranges.shape == (345, 1079)
    assert np.isfinite(recording.lidar.ranges[:]).mean() > 0.9
    assert [issue.code for issue in recording.warnings] == ["topics-left", "no-mount"]
    np.testing.assert_allclose(np.linalg.norm(recording.imu.linear_acceleration_g.mean(axis=0)), 1.0, atol=0.02)
