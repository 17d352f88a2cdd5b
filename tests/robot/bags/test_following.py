"""MCAP files that are still being written: what is there until now, and what ends it."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import numpy as np
import pytest
from growing_files import MAGIC, assert_begins, assert_same, growing, pieces, repacked
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st
from made_bags import START, drive, make_bag, odometry, placed, scan

from moteslam.errors import InputError
from moteslam.robot.formats import follow_recording, open_recording, write_recording
from moteslam.robot.recording import Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate

KINDS = ("mcap", "zstd", "loose", "chunks")


def transforms_alone() -> Iterator:
    """Odometry of transforms, whose frame on the robot comes after the first scans."""
    for index in range(12):
        yield placed(0.1 * index, "odom", "base_link", (0.1 * index, 0.0, 0.0))
        yield scan(0.1 * index + 0.01, np.linspace(1.0, 5.0, 7))
        if index == 3:
            yield placed(0.1 * index, "base_link", "laser", (0.2, 0.1, 0.3), topic="/tf_static")


@pytest.fixture(scope="module")
def contents(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """The bytes of files of each kind."""
    made = {kind: make_bag(tmp_path_factory.mktemp(kind), drive(20), kind).read_bytes() for kind in ("mcap", "zstd")}
    file = tmp_path_factory.mktemp("simulated") / "simulated.mcap"
    write_recording(file, simulate(load_scenario("corridor").model_copy(update={"duration": 0.5})).recording)
    return {
        **made,
        "loose": repacked(made["mcap"], 0),
        "chunks": repacked(made["mcap"], 3),
        "transforms": repacked(make_bag(tmp_path_factory.mktemp("tf"), transforms_alone(), "mcap").read_bytes(), 1),
        "own": repacked(file.read_bytes(), 0),
    }


@pytest.mark.parametrize("kind", [*KINDS, "transforms", "own"])
@settings(max_examples=15, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(0, 1 << 20), max_size=30))
@example(cuts=[10301])  # of the file that this package wrote: computed odometry, and no stream yet
def test_the_last_recording_is_that_of_the_finished_file(
    tmp_path: Path, contents: dict[str, bytes], kind: str, cuts: list[int]
) -> None:
    path = tmp_path / "robot.mcap"
    path.unlink(missing_ok=True)
    follower = follow_recording(path)
    found = list(growing(path, follower, pieces(contents[kind], cuts)))
    last = follower.poll(last=True)
    assert last is not None
    assert_same(last, open_recording(path))
    if kind != "transforms":  # there the lidar stands elsewhere from the fourth scan on
        for recording in found:
            assert_begins(recording, last)


@pytest.mark.parametrize("kind", ["loose", "chunks"])
def test_messages_come_as_they_are_written(tmp_path: Path, contents: dict[str, bytes], kind: str) -> None:
    path = tmp_path / "robot.mcap"
    follower = follow_recording(path)
    cuts = list(range(0, len(contents[kind]), 101))
    scans = [len(found.lidar or ()) for found in growing(path, follower, pieces(contents[kind], cuts))]
    assert sorted(set(scans)) == list(range(21))
    assert scans == sorted(scans)
    assert follower.poll() is None


def test_the_streams_of_an_own_file_have_its_figures(contents: dict[str, bytes], tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    path.write_bytes(contents["own"])
    recording = follow_recording(path).poll()
    assert recording is not None
    assert recording.encoders is not None
    assert recording.odometry is None
    assert recording.platform.name == "ucsd"


def test_a_message_received_before_those_that_are_there_finds_its_place(tmp_path: Path) -> None:
    events = [odometry(0.1 * k, (0.1 * k, 0, 0)) for k in range(6)]
    received = [START + k for k in (1, 2, 5, 6, 3, 4)]
    content = repacked(make_bag(tmp_path, events, "mcap", received=received).read_bytes(), 0)
    path = tmp_path / "robot.mcap"
    follower = follow_recording(path)
    list(growing(path, follower, pieces(content, list(range(0, len(content), 50)))))
    last = follower.poll(last=True)
    assert last is not None
    assert_same(last, open_recording(path))


def test_the_topic_that_was_first_is_read_on(tmp_path: Path) -> None:
    def two_lidars() -> Iterator:
        for k in range(4):
            yield scan(0.1 * k, np.linspace(1.0, 5.0, 7), topic="/front")
        for k in range(4, 12):
            yield scan(0.1 * k, np.linspace(1.0, 5.0, 9), topic="/back")

    content = repacked(make_bag(tmp_path, two_lidars(), "mcap").read_bytes(), 0)
    path = tmp_path / "robot.mcap"
    follower = follow_recording(path)
    *_, found = growing(path, follower, pieces(content, list(range(0, len(content), 60))))
    assert found.lidar.ranges.shape == (4, 7)
    assert [str(issue) for issue in found.warnings if issue.code == "topics-held"] == [
        "robot.mcap: /front read on, though other topics have more messages"
    ]
    assert open_recording(path).lidar.ranges.shape == (8, 9)  # type: ignore[union-attr]


def followed(path: Path, content: bytes):
    """A follower that has read a file."""
    path.write_bytes(content)
    follower = follow_recording(path)
    assert isinstance(follower.poll(), Recording)
    return follower


def test_a_file_that_shrinks_or_is_replaced_is_refused(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "robot.mcap"
    follower = followed(path, contents["loose"])
    with path.open("r+b") as file:
        file.truncate(500)
    with pytest.raises(InputError, match=r"robot\.mcap: has 500 bytes, [0-9]+ were read; expected it to grow"):
        follower.poll()
    follower = followed(path, contents["loose"])
    (tmp_path / "other").write_bytes(contents["loose"])
    (tmp_path / "other").replace(path)
    with pytest.raises(InputError, match=r"robot\.mcap: was replaced while it was read"):
        follower.poll()


def test_a_damaged_chunk_is_refused(tmp_path: Path, contents: dict[str, bytes]) -> None:
    path = tmp_path / "robot.mcap"
    follower = followed(path, contents["chunks"])
    body = bytearray(28 + 4 + 8)
    body[28:32] = b"\xff" * 4
    with path.open("ab") as file:
        file.write(b"\x06" + len(body).to_bytes(8, "little") + body)
    with pytest.raises(InputError, match=r"robot\.mcap: chunk at byte [0-9]+ is damaged"):
        follower.poll()


def test_a_file_without_messages_has_none_yet(tmp_path: Path) -> None:
    path = tmp_path / "robot.mcap"
    follower = follow_recording(path)
    for content in (MAGIC[:5], MAGIC, MAGIC + b"\x01"):
        path.write_bytes(content)
        assert follower.poll() is None
    with pytest.raises(InputError, match=r"robot\.mcap: no channel of messages, expected cdr or ros1"):
        follower.poll(last=True)


def test_a_database_is_refused(tmp_path: Path) -> None:
    path = make_bag(tmp_path, drive(2), "db3")
    with closing(sqlite3.connect(path)):
        pass
    with pytest.raises(
        InputError,
        match=r"made\.db3: SQLite file of ROS 2, expected what can be read while it is written: CARMEN log or MCAP",
    ):
        follow_recording(path)
