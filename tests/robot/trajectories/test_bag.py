"""Trajectories in ROS bags, written by rosbags; topics of poses are those that evo reads, too."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_bags import SECOND, START, make_bag, placed
from refusals import refusal

from moteslam.errors import InputError
from moteslam.robot.formats.bags.write import Event, header, turned, vector
from moteslam.robot.se2 import wrap
from moteslam.robot.trajectories import is_trajectory, read_trajectory

BEGIN = START / SECOND
TIMES = np.arange(20) / 10
HEADINGS = np.linspace(0, 1.5, 20)
PLACES = np.column_stack((np.sin(HEADINGS), 1 - np.cos(HEADINGS), np.zeros(20)))


def posed(k: int, kind: str = "geometry_msgs/PoseStamped", *, topic: str = "/pose", frame: str = "map") -> Event:
    """The k-th pose of a drive, as a message of a kind."""
    stamp = START + round(TIMES[k] * SECOND)
    point = vector(*PLACES[k].tolist())
    pose = {"position": point, "orientation": turned(HEADINGS[k])}
    values = {"header": header(stamp, frame), "point": point, "pose": pose}
    if kind in ("geometry_msgs/PoseWithCovarianceStamped", "nav_msgs/Odometry"):
        values["pose"] = {"pose": pose}
    return Event(stamp, topic, kind, values)


def drive(kind: str = "geometry_msgs/PoseStamped", **how: Any) -> list[Event]:
    return [posed(k, kind, **how) for k in range(20)]


def unstamped(event: Event) -> Event:
    return replace(event, values={**event.values, "header": header(0, "map")})


KINDS = ("PoseStamped", "PoseWithCovarianceStamped", "PointStamped")


@pytest.mark.parametrize("storage", ["bag", "folder"])
@pytest.mark.parametrize("kind", [*(f"geometry_msgs/{kind}" for kind in KINDS), "nav_msgs/Odometry"])
def test_a_topic_of_poses(tmp_path: Path, kind: str, storage: str) -> None:
    path = make_bag(tmp_path, drive(kind), storage)
    found = read_trajectory(f"{path}:/pose")
    np.testing.assert_allclose(found.stamps, BEGIN + TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :2], PLACES[:, :2], atol=1e-15)
    assert found.oriented == (kind != "geometry_msgs/PointStamped")
    if found.oriented:
        np.testing.assert_allclose(found.poses[:, 2], HEADINGS, atol=1e-12)
    assert is_trajectory(f"{path}:pose")
    assert not is_trajectory(path)


def test_it_is_read_as_evo_reads_it(tmp_path: Path) -> None:
    from evo.tools import file_interface
    from rosbags.rosbag1 import Reader

    path = make_bag(tmp_path, drive("nav_msgs/Odometry"))
    with Reader(path) as reader:
        theirs = file_interface.read_bag_trajectory(reader, "/pose")
    ours = read_trajectory(f"{path}:/pose")
    np.testing.assert_allclose(theirs.timestamps, ours.stamps, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(theirs.positions_xyz[:, :2], ours.poses[:, :2])
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], ours.poses[:, 2], atol=1e-12)


def test_the_last_path_counts(tmp_path: Path) -> None:
    paths = []
    for count in (5, 20):
        values = {"header": header(START, "map"), "poses": [event.values for event in drive()[:count]]}
        paths.append(Event(START, "/path", "nav_msgs/Path", values))
    found = read_trajectory(f"{make_bag(tmp_path, paths)}:/path")
    np.testing.assert_allclose(found.poses[:, :2], PLACES[:, :2], atol=1e-15)
    assert [issue.code for issue in found.warnings] == ["last-path"]


def test_transforms_from_frame_to_frame(tmp_path: Path) -> None:
    """map -> odom, slowly; odom -> base; base -> lidar, fixed, corrected later."""
    messages = [placed(0, "base", "lidar", (9, 9, 9), turn=turned(2.0), topic="/tf_static")]
    for k, time in enumerate(TIMES.tolist()):
        messages.append(placed(time, "odom", "base", PLACES[k].tolist(), turn=turned(HEADINGS[k])))
        if k % 5 == 0 or k == 19:
            messages.append(placed(time, "map", "odom", (1, time, 0), turn=turned(0.1 * time)))
    messages.append(placed(5, "base", "lidar", (0.2, 0, 0), turn=turned(np.pi / 2), topic="/tf_static"))
    path = make_bag(tmp_path, messages, "folder")
    direct = read_trajectory(f"{path}:tf:odom:base")
    np.testing.assert_allclose(direct.poses, np.column_stack((PLACES[:, :2], HEADINGS)), atol=1e-12)
    found = read_trajectory(f"{path}:tf:map:lidar")
    angle = 0.1 * TIMES
    lidar = PLACES[:, :2] + 0.2 * np.column_stack((np.cos(HEADINGS), np.sin(HEADINGS)))
    x = 1 + np.cos(angle) * lidar[:, 0] - np.sin(angle) * lidar[:, 1]
    y = TIMES + np.sin(angle) * lidar[:, 0] + np.cos(angle) * lidar[:, 1]
    np.testing.assert_allclose(found.poses, np.column_stack((x, y, wrap(angle + HEADINGS + np.pi / 2))), atol=1e-6)
    np.testing.assert_allclose(found.stamps, BEGIN + TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("messages", "code"),
    [
        ([*drive()[:3], *drive()[2:]], "doubles"),
        ([unstamped(posed(0)), *drive()], "zero-stamps"),
        ([unstamped(event) for event in drive()], "no-stamps"),
    ],
)
def test_what_was_left_out_or_assumed_is_told(tmp_path: Path, messages: list[Event], code: str) -> None:
    found = read_trajectory(f"{make_bag(tmp_path, messages)}:/pose")
    assert [issue.code for issue in found.warnings] == [code]
    assert len(found) == 20
    np.testing.assert_allclose(found.stamps[0], BEGIN, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("/none", "/pose (PoseStamped), /tf (TFMessage), /tf_static (TFMessage)"),
        ("/tf", "tf2_msgs/TFMessage"),
        ("tf:map:base", "a:b, b:c"),
        ("tf:b:c", "fixed"),
        ("tf:map", "tf:PARENT:CHILD"),
        ("/back", "jumps back"),
        ("/frames", "several frames"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, words: str) -> None:
    twice = [*drive(topic="/back"), *drive(topic="/back")]
    frames = [*drive(topic="/frames"), *drive(topic="/frames", frame="odom")]
    tree = [placed(0.5, "a", "b"), placed(0, "b", "c", topic="/tf_static")]
    path = make_bag(tmp_path, [*drive(), *tree] if name == "/none" else [*drive(), *twice, *frames, *tree])
    with refusal(InputError, file=f"{path}:{name}") as caught:
        read_trajectory(f"{path}:{name}")
    assert words in caught.value.problem


def test_a_bag_whose_topic_is_not_named_and_one_that_is_none(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive())
    with pytest.raises(InputError, match=r"is a bag, expected its topic, made\.bag:TOPIC .* /pose \(PoseStamped\)"):
        read_trajectory(path)
    (tmp_path / "broken.bag").write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="topics of poses: none"):
        read_trajectory(tmp_path / "broken.bag:/pose")
    with pytest.raises(InputError, match="No such file"):
        read_trajectory(tmp_path / "none.bag:/pose")
