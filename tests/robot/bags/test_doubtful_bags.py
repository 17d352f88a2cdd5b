"""What is wrong with bags that people have: read rightly with a warning, or refused in a line that says what to do."""

import math
import re
import shutil
import sqlite3
from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import SECOND, START, codes, drive, imu, make_bag, odometry, placed, scan
from refusals import refusal

from moteslam import open_recording
from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats.bags.storage import zstd
from moteslam.robot.formats.bags.write import Event, header


def stamped(event: Event, seconds: float) -> Event:
    """The same message with another stamp in its header."""
    frame = event.values["header"]["frame_id"]
    return replace(event, values={**event.values, "header": header(round(seconds * SECOND), frame)})


def room(angles: np.ndarray) -> np.ndarray:
    """The ranges to the walls of a square room of 6 m in the directions of these angles."""
    return 3.0 / np.maximum(np.abs(np.cos(angles)), np.abs(np.sin(angles)))


@pytest.mark.parametrize("turn", [1, -1], ids=["counterclockwise", "clockwise"])
@pytest.mark.parametrize("vary", ["number", "first"])
def test_beams_that_differ_from_scan_to_scan_are_laid_on_one_fan(tmp_path: Path, turn: int, vary: str) -> None:
    events = []
    for index in range(30):
        beams = 430 + 7 * (index * 5 % 13) if vary == "number" else 450
        first = turn * (-math.pi + (0.0 if vary == "number" else 0.013 * (index % 7)))
        step = turn * 2 * math.pi / beams
        ranges = room(first + step * np.arange(beams))
        figures = {"angle_min": first, "angle_max": first + (beams - 1) * step, "angle_increment": step}
        events.append(scan(0.1 * index, ranges, time_increment=0.09 / beams, **figures))
    recording = open_recording(make_bag(tmp_path, events))
    lidar = recording.lidar
    assert codes(recording) == ["other-scans", "no-mount"]
    assert len(lidar) == 30
    assert lidar.angle_increment * turn > 0
    assert lidar.time_increment * lidar.ranges.shape[1] == pytest.approx(0.09, rel=0.03)
    seen = np.isfinite(lidar.ranges[:])
    assert (seen.sum(axis=1) > 420).all()
    row, beam = np.nonzero(seen)
    np.testing.assert_allclose(lidar.ranges[:][row, beam], room(lidar.angles[beam]), atol=3 * math.sqrt(2) * 0.002)


def reset(first: float, second: float, *, rising: bool = True) -> Iterator[tuple[Event, int]]:
    """Two runs, the second with the stamps of the first; ``rising`` times of reception, or those of the stamps."""
    for run, length in enumerate((first, second)):
        for index in range(round(10 * length)):
            time, received = 0.1 * index, 0.1 * index + (run * first if rising else 0)
            yield scan(time, np.full(5, 1.0 + run)), START + round(received * SECOND)
            yield odometry(time, (time, float(run), 0.0)), START + round(received * SECOND) + 1


@pytest.mark.parametrize("kind", ["bag", "mcap", "db3"])
@pytest.mark.parametrize("rising", [True, False])
@pytest.mark.parametrize(("session", "run", "scans"), [(None, 1, 60), (1, 0, 40), ("2", 1, 60)])
def test_a_clock_that_is_set_back_cuts_the_recording(
    tmp_path: Path, kind: str, rising: bool, session: str | int | None, run: int, scans: int
) -> None:
    events, received = zip(*reset(4.0, 6.0, rising=rising), strict=True)
    recording = open_recording(make_bag(tmp_path, events, kind, received=received), sequence=session)
    assert codes(recording)[0] == "sessions"
    assert "the sessions are 1 (3.9 s), 2 (5.9 s)" in recording.warnings[0].message
    assert len(recording.lidar) == scans
    assert (recording.lidar.ranges[:] == 1.0 + run).all()
    assert (recording.odometry.poses[:, 1] == run).all()
    np.testing.assert_allclose(recording.odometry.poses[:, 0], 0.1 * np.arange(scans), atol=1e-12)


def test_stamps_of_zero_do_not_make_a_session_long(tmp_path: Path) -> None:
    unset = [(stamped(scan(0.1 * i, np.full(5, 1.0)), 0.0), START - SECOND + i) for i in range(3)]
    events, received = zip(*unset, *reset(4.0, 6.0), strict=True)
    recording = open_recording(make_bag(tmp_path, events, "mcap", received=received))
    assert "the sessions are 1 (3.9 s), 2 (5.9 s); session 2 is read" in recording.warnings[0].message
    assert len(recording.lidar) == 60


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_a_clock_that_is_set_back_by_less_than_a_second_cuts_all_streams(tmp_path: Path, kind: str) -> None:
    moves = [odometry(0.02 * i, (0.01 * i, 0.0, 0.0)) for i in range(1000)]
    events = sorted((*moves, *(scan(0.4 * i, [1.0 + i / 8, 2.0]) for i in range(50))), key=lambda event: event.time)
    back = [stamped(each, each.time / SECOND - (0.8 if each.time >= START + 8 * SECOND else 0.0)) for each in events]
    recording = open_recording(make_bag(tmp_path, back, kind, received=[event.time for event in events]))
    assert codes(recording) == ["sessions", "no-mount"]
    np.testing.assert_array_equal(recording.lidar.ranges[:, 0], 1 + np.arange(20, 50) / 8)
    np.testing.assert_allclose(recording.odometry.poses[:, 0], 0.01 * np.arange(400, 1000))


def test_a_stream_that_the_session_has_not_is_left_out(tmp_path: Path) -> None:
    events, received = zip(*reset(4.0, 6.0), strict=True)
    early = [imu(0.1 * i, (0.0, 0.0, 0.1)) for i in range(9)]
    path = make_bag(tmp_path, [*early, *events], received=[START] * 9 + list(received))
    recording = open_recording(path)
    assert recording.imu is None
    assert codes(recording)[:2] == ["sessions", "no-mount"]
    assert "/imu: no message in the session that is read" in str(recording.warnings[2])
    assert open_recording(path, sequence=1).imu is not None


@pytest.mark.parametrize(("session", "problem"), [("3", "'3', expected 1 to 2"), ("x", "'x', expected 1 to 2")])
def test_a_session_that_is_not_there_is_refused(tmp_path: Path, session: str, problem: str) -> None:
    events, received = zip(*reset(4.0, 6.0), strict=True)
    with pytest.raises(InputError, match=problem):
        open_recording(make_bag(tmp_path, events, received=received), sequence=session)


@pytest.mark.parametrize(
    ("late", "fraction", "told"),
    [(0.01, 0.0, ["no-header-stamps"]), (0.01, 1e-6, ["no-header-stamps"]), (3600.0, 0.0, [])],
)  # milliseconds written as microseconds are no fractions
def test_stamps_of_whole_seconds_are_those_of_reception_on_the_same_clock(
    tmp_path: Path, late: float, fraction: float, told: list[str]
) -> None:
    times = [1.6e9 + i // 10 + fraction * (0.1 * i % 1) for i in range(40)]
    events = [stamped(scan(0.1 * i, [1.0 + i / 50, 2.0], frame="base_link"), times[i]) for i in range(40)]
    moves = [odometry(0.1 * i, (0.1 * i, 0.0, 0.0)) for i in range(40)]
    received = [START + round((0.1 * i + late) * SECOND) for i in range(40)]
    recording = open_recording(make_bag(tmp_path, [*events, *moves], received=2 * received))
    assert codes(recording) == told
    expected = 0.1 * np.arange(40) + late if told else np.arange(40) // 10
    np.testing.assert_allclose(recording.lidar.stamps - 1.6e9, expected, atol=1e-6)


@pytest.mark.parametrize("count", [1, 3, 9])
def test_first_stamps_of_zero_are_dropped(tmp_path: Path, count: int) -> None:
    events = [
        stamped(event, 0.0) if i < count else event
        for i, event in enumerate(scan(0.1 * i, [1.0 + i / 4, 2.0]) for i in range(30))
    ]
    recording = open_recording(make_bag(tmp_path, events))
    assert [(issue.code, issue.count) for issue in recording.warnings] == [("unset-stamps", count), ("no-mount", 1)]
    np.testing.assert_array_equal(recording.lidar.ranges[:, 0], 1 + np.arange(count, 30) / 4)


def test_doubles_and_empty_scans_are_left_aside_and_counted(tmp_path: Path) -> None:
    events = [scan(0.1 * i, [] if i in (3, 4, 5, 6, 7) else [1.0 + i, 2.0]) for i in range(20)]
    moves = [odometry(0.1 * i, (0.1 * i, 0.0, 0.0)) for i in range(20)]
    another = scan(1.1, [7.0, 7.0])  # at the stamp of one before, and not the same
    again = [events[9], events[10], moves[4], another]
    recording = open_recording(make_bag(tmp_path, [*events[:12], *moves, *again, *events[12:]]))
    found = [(issue.code, issue.count) for issue in recording.warnings if issue.code != "no-mount"]
    assert found == [("doubles", 2), ("empty-scans", 5), ("doubles", 1)]
    assert len(recording.lidar) == 16
    assert len(recording.odometry) == 20


@pytest.mark.parametrize("late", [0.02, 0.06, 0.25], ids=["at once", "half a period later", "after two others"])
def test_scans_published_twice_are_dropped_before_anything_is_made_of_their_stamps(tmp_path: Path, late: float) -> None:
    once = [scan(0.12 * i, [1.0 + i, *[2.0] * 19], time_increment=0.005) for i in range(30)]
    again = [stamped(each, START / SECOND + 0.12 * i + late) for i, each in enumerate(once)]
    order = sorted(range(60), key=lambda k: 0.12 * (k % 30) + late * (k >= 30))
    recording = open_recording(make_bag(tmp_path, [[*once, *again][k] for k in order]))
    assert [(issue.code, issue.count) for issue in recording.warnings] == [("doubles", 30), ("no-mount", 1)]
    assert len(recording.lidar) == 30
    assert recording.lidar.time_increment == pytest.approx(0.005)


def test_scans_of_two_lidars_on_one_topic_are_refused(tmp_path: Path):
    events = [scan(0.1 * i, [1.0, 2.0], frame="rear" if i % 2 else "front") for i in range(30)]
    with refusal(InputError, "front, rear", field="/scan"):
        open_recording(make_bag(tmp_path, events))


@pytest.mark.parametrize(
    "views",
    [[max(i - 20, 0) for i in range(40)], [*range(20), *np.random.default_rng(0).permutation(20).tolist()]],
    ids=["it stands", "at rest, at any time"],
)
def test_scans_of_a_robot_at_rest_are_no_doubles(tmp_path: Path, views: list[int]) -> None:
    events = [scan(0.12 * i, [1.0 + 0.01 * view, 2.0, 3.0]) for i, view in enumerate(views)]
    assert len(open_recording(make_bag(tmp_path, events)).lidar) == 40


def other_odometry(topic: str, frame: str, child: str, count: int, *, x: float = 9.0) -> list[Event]:
    events = [odometry(0.05 * index, (x, 0.0, 0.0), topic=topic, child=child) for index in range(count)]
    return [replace(event, values={**event.values, "header": header(event.time, frame)}) for event in events]


@pytest.mark.parametrize(
    ("topic", "frame", "child", "code"),
    [
        ("/ground_truth/state", "world", "base_link", "truth-left"),
        ("/ego/basetruth", "odom", "base_link", "truth-left"),
        ("/gazebo/model_states/robot", "odom", "base_link", "truth-left"),
        ("/truth", "odom", "base_link", "truth-left"),
        ("/localised", "map", "base_link", "truth-left"),
        ("/other/odom", "odom2", "other_base", "other-robot"),
        ("/filtered", "anything", "base_link", "topics-left"),
    ],
)
def test_the_odometry_is_that_of_the_lidars_robot_and_never_the_truth(
    tmp_path: Path, topic: str, frame: str, child: str, code: str
) -> None:
    elsewhere = [placed(0, "other_base", "other_laser", topic="/tf_static")]
    path = make_bag(tmp_path, [*drive(), *elsewhere, *other_odometry(topic, frame, child, 50)])
    recording = open_recording(path)
    assert codes(recording) == [code]
    assert topic in recording.warnings[0].message
    assert len(recording.odometry) == 20
    named = open_recording(path, topics={"odometry": (topic,)})
    assert (named.odometry.poses[:, 0] == 9.0).all()


@pytest.mark.parametrize(("namespace", "told"), [("/a", []), ("/b", ["other-robot"])])
def test_the_only_odometry_is_used_and_told_where_it_is_of_another_namespace(
    tmp_path: Path, namespace: str, told: list[str]
) -> None:
    topics = {"/odom": f"{namespace}/odom", "/scan": "/a/scan"}
    events = [replace(event, topic=topics.get(event.topic, event.topic)) for event in drive()]
    recording = open_recording(make_bag(tmp_path, events))
    assert codes(recording) == told
    assert len(recording.odometry) == 20


def test_of_two_odometries_the_one_with_a_covariance_is_read_and_the_choice_told(tmp_path: Path) -> None:
    measured = list(drive())
    for event in measured:
        if event.topic == "/odom":
            event.values["pose"]["covariance"] = np.full(36, 0.01)
    true = other_odometry("/carla/ego/odometry", "odom", "base_link", 50)
    recording = open_recording(make_bag(tmp_path, [*measured, *true]))
    assert codes(recording) == ["topics-left"]
    assert "/odom (20 messages) used; left aside: /carla/ego/odometry" in recording.warnings[0].message
    assert "SLAM's errors mean nothing" in recording.warnings[0].message
    assert len(recording.odometry) == 20


@pytest.mark.parametrize("topic", ["/odom", "/tf"])
@pytest.mark.parametrize("rate", [1, 2, 5, 40])
def test_odometry_of_two_nodes_in_turns_is_told_and_not_used_but_for_a_few_readings(
    tmp_path: Path, topic: str, rate: int
) -> None:
    events = [scan(0.1 * i, [1.0, 2.0], frame="base_link") for i in range(100)]
    for i in range(500):
        places = [(0.01 * i, 0.0, 0.0), (0.0105 * i, 0.1, 0.01)]
        for late, place in enumerate(places[: 2 if i % rate == 0 else 1]):
            time = 0.02 * i + 0.005 * late
            is_tf = topic == "/tf"
            events.append(placed(time, "odom", "base_link", place) if is_tf else odometry(time, place))
    events.sort(key=lambda event: event.time)
    recording = open_recording(make_bag(tmp_path, events))
    assert [issue.code for issue in recording.warnings] == ["odometry-unfit"]
    assert topic in recording.warnings[0].message
    assert (recording.odometry is None) is (rate < 40)


@pytest.mark.parametrize(("x", "told"), [(0.0, ["mount-moves"]), (0.15, [])])
def test_a_lidar_of_two_parents_that_put_it_apart_is_told(tmp_path: Path, x: float, told: list[str]) -> None:
    mast = [placed(0, "base_link", "mast", (x, 0.1, 0.3), topic="/tf_static")]
    mast += [placed(0, "mast", "laser", (0.05, 0.0, 0.0), topic="/tf_static")]
    recording = open_recording(make_bag(tmp_path, [*drive(), *mast]))
    assert codes(recording) == told
    assert recording.platform.lidar.x == 0.2


def test_of_two_robots_the_lidars_odometry_and_transforms_are_read(tmp_path: Path) -> None:
    events = []
    for robot, count, x in (("a", 40, 1.0), ("b", 20, 2.0)):
        events += other_odometry(f"/{robot}/odom", "odom", "base_link", count, x=x)
        events.append(placed(0, "base_link", "laser", (x, 0.0, 0.0), topic=f"/{robot}/tf_static"))
        events += [scan(0.1 * i, [1.0, 2.0], topic=f"/{robot}/scan") for i in range(count)]
    recording = open_recording(make_bag(tmp_path, events), topics={"lidar": ("/b/scan",)})
    assert (recording.odometry.poses[:, 0] == 2.0).all()
    assert recording.platform.lidar.x == 2.0


def with_wal(folder: Path) -> Path:
    """A SQLite bag whose recorder was killed: the second half of its messages is in the ``-wal`` file alone."""
    made = make_bag(folder, drive(), "db3")
    path = folder / "killed_0.db3"
    connection = sqlite3.connect(made)
    connection.execute("PRAGMA journal_mode = WAL")
    rows = connection.execute("SELECT * FROM messages WHERE id > 30").fetchall()
    connection.execute("DELETE FROM messages WHERE id > 30")
    connection.commit()
    connection.execute("PRAGMA wal_checkpoint(TRUNCATE)").fetchall()
    connection.executemany("INSERT INTO messages VALUES (?, ?, ?, ?)", rows)
    connection.commit()
    shutil.copyfile(made, path)
    shutil.copyfile(f"{made}-wal", f"{path}-wal")
    connection.close()
    return path


def test_a_wal_beside_a_database_is_read_and_nothing_is_written_there(tmp_path: Path) -> None:
    (tmp_path / "x").mkdir()
    path = with_wal(tmp_path / "x")
    before = {file: file.read_bytes() for file in path.parent.glob("killed*")}
    recording = open_recording(path)
    assert len(recording.lidar) == 20
    assert recording.lidar.ranges[19, 0] == np.float32(1.19)
    assert codes(recording) == ["damaged-bag"]
    assert {file: file.read_bytes() for file in path.parent.glob("killed*")} == before
    Path(f"{path}-wal").unlink()
    assert len(open_recording(path).lidar) == 6


def split(folder: Path, kind: str, names: tuple[str, ...]) -> Path:
    """A recording in parts of ten scans, without metadata."""
    (folder / "drive").mkdir()
    events = list(drive(10 * len(names)))
    for number, name in enumerate(names):
        (folder / name).mkdir()
        made = make_bag(folder / name, events[50 * number : 50 * (number + 1)], kind)
        made.rename(folder / "drive" / name)
    return folder / "drive"


@pytest.mark.parametrize(("kind", "metadata"), [("mcap", None), ("db3", "")])
def test_parts_without_metadata_are_one_recording(tmp_path: Path, kind: str, metadata: str | None) -> None:
    folder = split(tmp_path, kind, tuple(f"drive_{number}.{kind}" for number in (0, 1, 10)))
    if metadata is not None:
        (folder / "metadata.yaml").write_text(metadata)
    recording = open_recording(folder)
    assert codes(recording) == ["no-metadata"]
    assert "8 are missing" in recording.warnings[0].message
    np.testing.assert_array_equal(recording.lidar.stamps, np.round(1.6e9 + 0.1 * np.arange(30), 6))
    assert recording.lidar.ranges[29, 0] == np.float32(1.29)


def test_recordings_that_are_no_parts_of_one_are_not_put_together(tmp_path: Path) -> None:
    folder = split(tmp_path, "mcap", ("monday_0.mcap", "tuesday_0.mcap"))
    with pytest.raises(InputError, match="a folder with recordings in it, expected one of them"):
        open_recording(folder)


def test_a_bag_of_fewer_messages_than_its_metadata_states_says_so(tmp_path: Path) -> None:
    folder = make_bag(tmp_path, drive(), "folder")
    assert open_recording(folder).warnings == ()
    with closing(sqlite3.connect(folder / "made.db3")) as connection:
        connection.execute("DELETE FROM messages WHERE id > 30")
        connection.commit()
    said = [issue.message for issue in open_recording(folder).warnings if issue.code == "damaged-bag"]
    assert any(re.search(r"/scan: \d+ of the \d+ messages that metadata.yaml states", message) for message in said)


def test_files_packed_as_a_whole_are_unpacked(tmp_path: Path) -> None:
    folder = make_bag(tmp_path, drive(), "folder")
    (folder / "made.db3.zstd").write_bytes(zstd.compress((folder / "made.db3").read_bytes()))
    (folder / "made.db3").unlink()
    text = (folder / "metadata.yaml").read_text().replace("made.db3", "made.db3.zstd")
    text = text.replace("compression_mode: ''", "compression_mode: FILE")
    (folder / "metadata.yaml").write_text(text.replace("compression_format: ''", "compression_format: zstd"))
    recording = open_recording(folder)
    assert recording.warnings == ()
    assert recording.lidar.ranges[19, 0] == np.float32(1.19)
    (folder / "made.db3.zstd").write_bytes(zstd.compress(bytes(200_000_000)))
    with pytest.raises(InputError, match="unpacks to more than a recording does: unpack it with zstd -d"):
        open_recording(folder)


def test_a_negative_time_between_beams_is_honoured(tmp_path: Path) -> None:
    events = [scan(0.1 * i, [1.0, 2.0, 3.0], time_increment=-0.01) for i in range(5)]
    recording = open_recording(make_bag(tmp_path, events))
    lidar = recording.lidar
    assert lidar.time_increment == recording.platform.lidar.time_increment == pytest.approx(0.01)
    np.testing.assert_array_equal(lidar.ranges[0], [3.0, 2.0, 1.0])
    np.testing.assert_allclose(lidar.angles, [math.pi / 2, 0.0, -math.pi / 2], atol=1e-6)
    assert lidar.stamps[0] == 1.6e9


def turned_path(change: Callable[[dict[str, float]], dict[str, float]]) -> list[Event]:
    """A robot that drives 3 m along x, turns in an arc, and drives 3 m along y; its quaternions are changed."""
    s = np.linspace(0, 6 + math.pi / 2, 160)
    yaw = np.clip(s - 3, 0, math.pi / 2)
    x = np.minimum(s, 3) + np.sin(yaw)
    y = 1 - np.cos(yaw) + np.maximum(0, s - 3 - math.pi / 2)
    events = [odometry(0.05 * k, (float(x[k]), float(y[k]), float(yaw[k]))) for k in range(len(s))]
    for event in events:
        pose: dict[str, Any] = event.values["pose"]["pose"]
        pose["orientation"] = change(pose["orientation"])
    return [*events, *(scan(0.1 * k, [1.0, 2.0], frame="base_link") for k in range(80))]


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda q: {**q, "w": 0.0}, "quaternions of length 0"),
        (lambda q: {**q, "w": q["w"] * 0.3}, "quaternions of lengths 0.3 to 0.74, not 1"),
        (lambda q: {**q, "z": 1.0, "w": 0.0}, "every heading is 180.0 degrees while the path turns"),
        (lambda q: {**q, "z": q["w"], "w": -q["z"]}, None),
        (lambda q: q, None),
    ],
)
def test_headings_that_are_none_are_named_and_not_used(
    tmp_path: Path, change: Callable[[dict[str, float]], dict[str, float]], problem: str | None
) -> None:
    recording = open_recording(make_bag(tmp_path, turned_path(change)))
    assert codes(recording) == (["no-headings"] if problem else [])
    if problem:
        assert problem in recording.warnings[0].message
        headings = recording.odometry.poses[:, 2]
        np.testing.assert_allclose(headings[[0, 20, 140, 159]], [0, 0, math.pi / 2, math.pi / 2], atol=1e-6)
        np.testing.assert_allclose(
            headings, np.clip(np.linspace(0, 6 + math.pi / 2, 160) - 3, 0, math.pi / 2), atol=0.1
        )


def test_a_robot_that_drives_back_does_not_turn_round(tmp_path: Path) -> None:
    places = [*np.linspace(0, 2, 50), *np.linspace(2, 0.5, 40)]
    events = [odometry(0.05 * k, (x, 0.0, 0.0)) for k, x in enumerate(places)]
    for event in events:
        event.values["pose"]["pose"]["orientation"] = dict.fromkeys("xyzw", 0.0)
    recording = open_recording(make_bag(tmp_path, [*events, scan(0, [1.0, 2.0], frame="base_link")]))
    np.testing.assert_allclose(recording.odometry.poses[:, 2], 0, atol=1e-9)


def test_streams_that_are_not_wanted_are_not_read(tmp_path: Path) -> None:
    broken = [odometry(0.1 * i, (math.nan, 0.0, 0.0)) for i in range(9)] + [
        imu(0.1 * i, (math.nan, 0, 0)) for i in range(9)
    ]
    path = make_bag(tmp_path, [*(scan(0.1 * i, [1.0, 2.0]) for i in range(9)), *broken])
    with pytest.raises(InputError, match="/odom: 9 of 9 messages broken"):
        open_recording(path)
    recording = open_recording(path, streams=("lidar",))
    assert len(recording.lidar) == 9
    assert codes(recording) == ["no-mount"]


def two_lidars() -> list[Event]:
    angles = np.linspace(-math.pi / 2, math.pi / 2, 181)
    events = []
    for topic, x in (("/front", 0.3), ("/rear", -0.3)):
        ranges = np.minimum((3 - 0.3) / np.maximum(np.cos(angles), 1e-9), 3 / np.maximum(np.abs(np.sin(angles)), 1e-9))
        events += [scan(0.1 * i, ranges, topic=topic, frame=f"{topic[1:]}_{x}") for i in range(4)]
    return events


def test_mounts_of_several_lidars_are_stated_by_topic(tmp_path: Path) -> None:
    path = make_bag(tmp_path, two_lidars())
    robot = tmp_path / "robot.toml"
    robot.write_text('[lidars."/front"]\nx = 0.3\n[lidars."/rear"]\nx = -0.3\nyaw = 3.14159265\n')
    topics = {"lidar": ("/front", "/rear")}
    with pytest.raises(InputError, match=r'two lidars at one place, .*a table \[lidars."/front"\]'):
        open_recording(path, topics=topics)
    recording = open_recording(path, topics=topics, platform=robot)
    assert recording.warnings == ()
    lidar = recording.lidar
    seen = np.isfinite(lidar.ranges[0])
    assert seen.mean() > 0.8
    np.testing.assert_allclose(lidar.ranges[0][seen], room(lidar.angles[seen]), atol=3 * math.sqrt(2) * math.radians(1))
    alone = open_recording(path, topics={"lidar": ("/rear",)}, platform=robot)
    assert alone.platform.lidar.pose == pytest.approx((-0.3, 0.0, 3.14159265))


@pytest.mark.parametrize(
    ("text", "error", "problem"),
    [
        ('[lidars."/side"]\nx = 1.0\n', InputError, "no lidar '/side'"),
        ('[lidars."/front"]\nbeams = 3\n', ConfigError, "expected a table a topic, with x, y, z and yaw"),
    ],
)
def test_mounts_that_are_none_are_refused(tmp_path: Path, text: str, error: type[Exception], problem: str) -> None:
    robot = tmp_path / "robot.toml"
    robot.write_text(text)
    path = make_bag(tmp_path, two_lidars())
    with pytest.raises(error, match=problem):
        open_recording(path, topics={"lidar": ("/front", "/rear")}, platform=robot)
