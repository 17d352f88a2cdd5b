"""CARMEN logs that are still being written: what is there until now, and what ends it."""

from __future__ import annotations

import gzip
from pathlib import Path

import numpy as np
import pytest
from growing_files import assert_begins, assert_same, growing, pieces
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from robot_logs import flaser, odom, robotlaser

from moteslam.errors import ConfigError, InputError
from moteslam.robot.formats import follow_recording, open_recording
from moteslam.robot.formats.no_return import RangeTally, no_return_limit

RANDOM = np.random.default_rng(3)
LINES = ["# a log", "PARAM robot_front_laser_max 8.0 host 0", "PARAM robot_frontlaser_offset 0.2 host 0"]
for k in range(24):
    LINES.append(odom((0.1 * k, 0.0, 0.01 * k), 100.0 + k))
    LINES.append(flaser(RANDOM.uniform(0, 9, 5).round(2).tolist(), stamp=100.2 + k, robot=(0.1 * k, 0, 0)))
LOG = ("\n".join(LINES) + "\n").encode()
UNSTATED = "\n".join(
    robotlaser(np.append(RANDOM.uniform(0, 5, 20).round(2), [8.183] * 3).tolist(), stamp=k, limit=0.0)
    for k in range(30)
).encode()
AT_ODDS = "\n".join(
    [
        *(f"RAWLASER1 0 -1.5 3 0.1 80 0.01 0 3 1 2 3 0 {k} host {k}" for k in range(3)),
        *(flaser([1.0, 2.0, 3.0], stamp=5.0 - k) for k in range(3)),
        "FLASER 3 1 2",
        *(flaser([1.0, -2.0, np.nan, 0.0], stamp=10.0 + k) for k in range(2)),
        *(flaser([1.0, -2.0, np.nan], stamp=10.0 + k) for k in range(30)),
        "RLASER 3 1 2 3",
    ]
).encode()


@pytest.mark.parametrize("content", [LOG, LOG[:-1], UNSTATED, AT_ODDS], ids=["log", "no end", "no limit", "at odds"])
@settings(max_examples=30, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(cuts=st.lists(st.integers(0, 1 << 20), max_size=40))
def test_the_last_recording_is_that_of_the_finished_log(tmp_path: Path, content: bytes, cuts: list[int]) -> None:
    path = tmp_path / "robot.log"
    path.unlink(missing_ok=True)
    follower = follow_recording(path)
    for recording in growing(path, follower, pieces(content, cuts)):
        whole = tmp_path / "part" / "robot.log"
        whole.parent.mkdir(exist_ok=True)
        whole.write_bytes(path.read_bytes().rpartition(b"\n")[0])
        assert_same(recording, open_recording(whole))
    last = follower.poll(last=True)
    assert last is not None
    assert_same(last, open_recording(path))


def test_every_recording_is_the_beginning_of_the_last(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    found = list(growing(path, follow_recording(path), pieces(LOG, list(range(0, len(LOG), 97)))))
    assert len(found) > 20
    for recording in found:
        assert_begins(recording, found[-1])


def test_nothing_new_is_none_and_a_line_is_read_when_it_ends(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = follow_recording(path)
    assert follower.poll() is None
    path.write_bytes(b"")
    assert follower.poll() is None
    path.write_bytes(b"# a head alone\n")
    assert follower.poll() is None
    line = odom((1.0, 2.0, 0.5), 7.0).encode()
    with path.open("ab") as file:
        file.write(line)
        file.flush()
        assert follower.poll() is None
        file.write(b"\n")
        file.flush()
        recording = follower.poll()
        assert recording is not None
        assert len(recording.odometry) == 1
        assert follower.poll() is None


def test_a_log_without_an_end_of_line_at_its_end_is_read_whole_at_last(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    path.write_bytes(LOG + odom((9.0, 0.0, 0.0), 200.0).encode())
    follower = follow_recording(path)
    recording = follower.poll()
    assert recording is not None
    assert len(recording.odometry) == 24
    recording = follower.poll(last=True)
    assert recording is not None
    assert len(recording.odometry) == 25


def test_a_byte_order_mark_is_passed_over(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    path.write_bytes(b"\xef\xbb\xbf")
    follower = follow_recording(path)
    assert follower.poll() is None
    path.write_bytes(b"\xef\xbb\xbf" + odom((1.0, 2.0, 0.5), 7.0).encode() + b"\n" + LOG)
    recording = follower.poll()
    assert recording is not None
    assert_same(recording, open_recording(path))


def followed(path: Path):
    """A follower that has read the log."""
    path.write_bytes(LOG)
    follower = follow_recording(path)
    assert follower.poll() is not None
    return follower


def test_a_log_that_shrinks_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = followed(path)
    with path.open("r+b") as file:
        file.truncate(100)
    with pytest.raises(InputError, match=rf"robot\.log: has 100 bytes, {len(LOG)} were read; expected it to grow"):
        follower.poll()


def test_another_file_in_its_place_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = followed(path)
    (tmp_path / "other").write_bytes(LOG + LOG)
    (tmp_path / "other").replace(path)
    with pytest.raises(InputError, match=r"robot\.log: was replaced while it was read, expected it to grow"):
        follower.poll()


def test_a_log_that_is_written_anew_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = followed(path)
    path.write_bytes(LOG.replace(b" 0.01 ", b" 0.02 ").replace(b"123.2 host", b"123.3 host") + LOG)
    with pytest.raises(InputError, match=r"robot\.log: was written anew while it was read"):
        follower.poll()


def test_a_log_that_is_gone_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = followed(path)
    path.unlink()
    with pytest.raises(InputError, match=r"robot\.log: No such file or directory, expected a CARMEN log"):
        follower.poll()


def test_garbage_in_its_lines_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log"
    follower = followed(path)
    with path.open("ab") as file:
        file.write(b"ODOM 1 2\n" * 4)
    recording = follower.poll()
    assert recording is not None
    assert [issue.code for issue in recording.warnings] == ["broken-lines"]
    with path.open("ab") as file:
        file.write(b"ODOM 1 2\n")
    with pytest.raises(InputError, match=r"robot\.log:52: 3 words, expected 10 for odometry \(first of 5 broken lines"):
        follower.poll()


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (None, r"robot\.log: No such file or directory, expected a recording"),
        (b"", r"robot\.log: is empty, expected a recording"),
        (b"a poem\n", r"robot\.log: not a recording known here, expected a "),
        (b"# a head\nODOM 1\n", r"robot\.log:2: 2 words, expected 10 for odometry"),
    ],
)
def test_what_is_no_recording_at_last_is_refused(tmp_path: Path, content: bytes | None, problem: str) -> None:
    path = tmp_path / "robot.log"
    if content is not None:
        path.write_bytes(content)
    follower = follow_recording(path)
    assert follower.poll() is None
    with pytest.raises(InputError, match=problem):
        follower.poll(last=True)


def test_a_packed_log_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "robot.log.gz"
    path.write_bytes(gzip.compress(LOG))
    with pytest.raises(InputError, match=r"robot\.log\.gz: packed by gzip, which cannot be read while it is written"):
        follow_recording(path)


def test_a_folder_and_another_format_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"not a recording known here"):
        follow_recording(tmp_path)
    path = tmp_path / "robot.csv"
    path.write_bytes(b"#ROSBAG V2.0\n")
    with pytest.raises(
        InputError, match=r"ROS 1 bag, expected what can be read while it is written: CARMEN log or MCAP file"
    ):
        follow_recording(path)


def test_a_platform_that_is_none_is_refused_before_the_log_is_there(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match=r"none\.toml: No such file"):
        follow_recording(tmp_path / "robot.log", platform=tmp_path / "none.toml")


@settings(max_examples=60)
@given(
    ranges=st.lists(st.sampled_from([0.0, 1.0, 2.5, 8.183, 8.187, 81.9, -1.0, np.nan, np.inf]), max_size=200),
    cut=st.integers(0, 200),
)
def test_ranges_tallied_in_parts_have_the_limit_of_all(ranges: list[float], cut: int) -> None:
    values = np.array(ranges, np.float32)
    tally = RangeTally()
    tally.add(values[:cut])
    tally.add(values[cut:])
    assert tally.limit(None) == no_return_limit(values, None)
