"""Trajectories in ROS bags, written by rosbags; topics of poses are those that evo reads, too."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_typestore

from moteslam.errors import InputError
from moteslam.eval.cli import main
from moteslam.robot.se2 import wrap
from moteslam.robot.trajectories import is_trajectory, read_trajectory

ROS1, ROS2 = get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_HUMBLE)
START = 1_600_000_000
TIMES = np.arange(20) / 10
HEADINGS = np.linspace(0, 1.5, 20)
PLACES = np.column_stack((np.sin(HEADINGS), 1 - np.cos(HEADINGS), np.zeros(20)))


class Made:
    """Messages of one version of ROS."""

    def __init__(self, *, ros1: bool) -> None:
        self.store, self.ros1 = (ROS1 if ros1 else ROS2), ros1

    def of(self, kind: str, *values: Any) -> Any:
        return self.store.types[kind](*values)

    def header(self, time: float, frame: str) -> Any:
        stamp = self.of(
            "builtin_interfaces/msg/Time", *((0, 0) if time < 0 else (START + int(time), round(time % 1 * 1e9)))
        )
        return self.of("std_msgs/msg/Header", *((0,) if self.ros1 else ()), stamp, frame)

    def turn(self, heading: float) -> Any:
        return self.of("geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(heading / 2)), float(np.cos(heading / 2)))

    def pose(self, place: Any, heading: float) -> Any:
        return self.of(
            "geometry_msgs/msg/Pose", self.of("geometry_msgs/msg/Point", *map(float, place)), self.turn(heading)
        )

    def stamped(self, time: float, place: Any, heading: float, frame: str = "map") -> Any:
        return self.of("geometry_msgs/msg/PoseStamped", self.header(time, frame), self.pose(place, heading))

    def message(self, kind: str, time: float, place: Any, heading: float, frame: str = "map") -> Any:
        head, pose = self.header(time, frame), self.pose(place, heading)
        with_covariance = self.of("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
        if kind == "PoseWithCovarianceStamped":
            return self.of("geometry_msgs/msg/PoseWithCovarianceStamped", head, with_covariance)
        if kind == "PointStamped":
            return self.of("geometry_msgs/msg/PointStamped", head, pose.position)
        if kind == "Odometry":
            zero = self.of("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
            twist = self.of(
                "geometry_msgs/msg/TwistWithCovariance", self.of("geometry_msgs/msg/Twist", zero, zero), np.zeros(36)
            )
            return self.of("nav_msgs/msg/Odometry", head, "base", with_covariance, twist)
        return self.stamped(time, place, heading, frame)

    def transform(self, time: float, parent: str, child: str, place: Any, heading: float) -> Any:
        where = self.of("geometry_msgs/msg/Vector3", *map(float, place))
        one = self.of("geometry_msgs/msg/Transform", where, self.turn(heading))
        stamped = self.of("geometry_msgs/msg/TransformStamped", self.header(time, parent), child, one)
        return self.of("tf2_msgs/msg/TFMessage", [stamped])


def bag_of(folder: Path, made: Made, messages: Iterable[tuple[str, Any]], begin: int = 0) -> Path:
    """A bag of topics and messages in this order, received a tenth of a second apart."""
    folder.mkdir(exist_ok=True)
    path = folder / ("made.bag" if made.ros1 else "made")
    writer: Any = Writer1(path) if made.ros1 else Writer2(path, version=8)
    known: dict[str, Any] = {}
    with writer:
        for k, (topic, message) in enumerate(messages, start=begin):
            kind = message.__msgtype__
            if topic not in known:
                known[topic] = writer.add_connection(topic, kind, typestore=made.store)
            serialise = made.store.serialize_ros1 if made.ros1 else made.store.serialize_cdr
            writer.write(known[topic], START * 10**9 + k * 10**8, bytes(serialise(message, kind)))
    return path


def drive(made: Made, kind: str, **how: Any) -> list[tuple[str, Any]]:
    return [
        ("/pose", made.message(kind, time, place, heading, **how))
        for time, place, heading in zip(TIMES.tolist(), PLACES, HEADINGS.tolist(), strict=True)
    ]


@pytest.mark.parametrize("ros1", [True, False])
@pytest.mark.parametrize("kind", ["PoseStamped", "PoseWithCovarianceStamped", "Odometry", "PointStamped"])
def test_a_topic_of_poses(tmp_path: Path, kind: str, ros1: bool) -> None:
    made = Made(ros1=ros1)
    path = bag_of(tmp_path, made, drive(made, kind))
    found = read_trajectory(f"{path}:/pose")
    np.testing.assert_allclose(found.stamps, START + TIMES, rtol=0, atol=1e-6)
    np.testing.assert_allclose(found.poses[:, :2], PLACES[:, :2], atol=1e-15)
    assert found.oriented == (kind != "PointStamped")
    if found.oriented:
        np.testing.assert_allclose(found.poses[:, 2], HEADINGS, atol=1e-12)
    assert is_trajectory(f"{path}:pose")
    assert not is_trajectory(path)


def test_it_is_read_as_evo_reads_it(tmp_path: Path) -> None:
    from evo.tools import file_interface
    from rosbags.rosbag1 import Reader

    made = Made(ros1=True)
    path = bag_of(tmp_path, made, drive(made, "Odometry"))
    with Reader(path) as reader:
        theirs = file_interface.read_bag_trajectory(reader, "/pose")
    ours = read_trajectory(f"{path}:/pose")
    np.testing.assert_allclose(theirs.timestamps, ours.stamps, rtol=0, atol=1e-6)
    np.testing.assert_array_equal(theirs.positions_xyz[:, :2], ours.poses[:, :2])
    np.testing.assert_allclose(theirs.get_orientations_euler("sxyz")[:, 2], ours.poses[:, 2], atol=1e-12)


def test_the_last_path_counts(tmp_path: Path) -> None:
    made = Made(ros1=False)
    paths = []
    for count in (5, 20):
        poses = [made.stamped(TIMES[k], PLACES[k], HEADINGS[k]) for k in range(count)]
        paths.append(("/path", made.of("nav_msgs/msg/Path", made.header(0.0, "map"), poses)))
    found = read_trajectory(f"{bag_of(tmp_path, made, paths)}:/path")
    np.testing.assert_allclose(found.poses[:, :2], PLACES[:, :2], atol=1e-15)
    assert [issue.code for issue in found.warnings] == ["last-path"]


def test_transforms_from_frame_to_frame(tmp_path: Path) -> None:
    """map -> odom, slowly; odom -> base; base -> lidar, fixed, corrected later."""
    made = Made(ros1=False)
    messages = [("/tf_static", made.transform(0, "base", "lidar", (9, 9, 9), 2.0))]
    for k, time in enumerate(TIMES.tolist()):
        messages.append(("/tf", made.transform(time, "odom", "base", PLACES[k], HEADINGS[k])))
        if k % 5 == 0 or k == 19:
            messages.append(("/tf", made.transform(time, "map", "odom", (1, time, 0), 0.1 * time)))
    messages.append(("/tf_static", made.transform(5, "base", "lidar", (0.2, 0, 0), np.pi / 2)))
    path = bag_of(tmp_path, made, messages)
    direct = read_trajectory(f"{path}:tf:odom:base")
    np.testing.assert_allclose(direct.poses, np.column_stack((PLACES[:, :2], HEADINGS)), atol=1e-12)
    found = read_trajectory(f"{path}:tf:map:lidar")
    angle = 0.1 * TIMES
    lidar = PLACES[:, :2] + 0.2 * np.column_stack((np.cos(HEADINGS), np.sin(HEADINGS)))
    x = 1 + np.cos(angle) * lidar[:, 0] - np.sin(angle) * lidar[:, 1]
    y = TIMES + np.sin(angle) * lidar[:, 0] + np.cos(angle) * lidar[:, 1]
    np.testing.assert_allclose(found.poses, np.column_stack((x, y, wrap(angle + HEADINGS + np.pi / 2))), atol=1e-6)
    np.testing.assert_allclose(found.stamps, START + TIMES, rtol=0, atol=1e-6)


@pytest.mark.parametrize(
    ("change", "code", "poses"),
    [
        (lambda made, messages: [*messages[:3], messages[2], *messages[3:]], "doubles", 20),
        (lambda made, messages: [("/pose", made.stamped(-1, (9, 9, 0), 0)), *messages], "zero-stamps", 20),
        (
            lambda made, messages: [("/pose", made.stamped(-1, place, 0.1 * k)) for k, place in enumerate(PLACES)],
            "no-stamps",
            20,
        ),
    ],
)
def test_what_was_left_out_or_assumed_is_told(tmp_path: Path, change: Any, code: str, poses: int) -> None:
    made = Made(ros1=True)
    path = bag_of(tmp_path, made, change(made, drive(made, "PoseStamped")))
    found = read_trajectory(f"{path}:/pose")
    assert [issue.code for issue in found.warnings] == [code]
    assert len(found) == poses
    np.testing.assert_allclose(found.stamps[0], START, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("/none", "/pose (PoseStamped), /tf (TFMessage)"),
        ("/tf", "tf2_msgs/TFMessage"),
        ("tf:map:base", "a:b, b:c"),
        ("tf:b:c", "fixed"),
        ("tf:map", "tf:PARENT:CHILD"),
        ("/back", "jumps back"),
        ("/frames", "several frames"),
    ],
)
def test_what_is_refused(tmp_path: Path, name: str, words: str) -> None:
    made = Made(ros1=False)
    twice = [("/back", message) for _, message in [*drive(made, "PoseStamped"), *drive(made, "PoseStamped")]]
    frames = [("/frames", m) for _, m in [*drive(made, "PoseStamped"), *drive(made, "PoseStamped", frame="odom")]]
    tree = [
        ("/tf", made.transform(0.5, "a", "b", (0, 0, 0), 0)),
        ("/tf_static", made.transform(0, "b", "c", (0, 0, 0), 0)),
    ]
    path = bag_of(tmp_path, made, [*drive(made, "PoseStamped"), *twice, *frames, *tree])
    if name == "/none":
        path = bag_of(tmp_path / "more", made, [*drive(made, "PoseStamped"), tree[0]])
    with pytest.raises(InputError) as caught:
        read_trajectory(f"{path}:{name}")
    assert words in caught.value.problem
    assert caught.value.file == f"{path}:{name}"
    assert "\n" not in str(caught.value)


def test_a_bag_whose_topic_is_not_named_and_one_that_is_none(tmp_path: Path) -> None:
    made = Made(ros1=True)
    path = bag_of(tmp_path, made, drive(made, "PoseStamped"))
    with pytest.raises(InputError, match=r"is a bag, expected its topic, made\.bag:TOPIC .* /pose \(PoseStamped\)"):
        read_trajectory(path)
    (tmp_path / "broken.bag").write_bytes(path.read_bytes()[:200])
    with pytest.raises(InputError, match="topics of poses: none"):
        read_trajectory(tmp_path / "broken.bag:/pose")
    with pytest.raises(InputError, match="No such file"):
        read_trajectory(tmp_path / "none.bag:/pose")


def test_parts_without_metadata_and_a_log_beside_one(tmp_path: Path) -> None:
    made = Made(ros1=False)
    poses = drive(made, "PoseStamped")
    for k, part in enumerate((poses[:12], poses[12:])):
        folder = bag_of(tmp_path / str(k), made, [("/pose", message) for _, message in part], begin=12 * k)
        (tmp_path / "both").mkdir(exist_ok=True)
        (folder / "made.db3").rename(tmp_path / "both" / f"made_{k}.db3")
    found = read_trajectory(f"{tmp_path / 'both'}:/pose")
    assert len(found) == 20
    assert [issue.code for issue in found.warnings] == ["no-metadata"]
    (tmp_path / "both" / "made_1.db3-wal").write_bytes(b"some")
    found = read_trajectory(f"{tmp_path / 'both'}:/pose")
    assert len(found) == 20
    assert [issue.code for issue in found.warnings] == ["no-metadata", "damaged-bag"]


def test_a_bag_is_converted_and_scored(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    made = Made(ros1=False)
    path = bag_of(tmp_path, made, drive(made, "PoseStamped"))
    assert main.run(["convert", f"{path}:/pose", str(tmp_path / "t.tum")]) == 0
    assert main.run(["evaluate", str(tmp_path / "t.tum"), f"{path}:/pose"]) == 0
    out, err = capsys.readouterr()
    assert ["ATE", "[m]", "20", "0.0000"] in [line.split()[:4] for line in out.splitlines()]
    assert err == ""
