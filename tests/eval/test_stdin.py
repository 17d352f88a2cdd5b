"""Messages on stdin: an update a line, the result of the recording, and lines that are left out."""

import io
import json
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from slam_messages import cut, messages, platform_of, sparse_corridor

from moteslam.eval.cli.main import run
from moteslam.robot.recording import Recording
from moteslam.slam.run import run_slam
from moteslam.slam.settings import resolve_config

SCANS = 60


@pytest.fixture(scope="module")
def recording() -> Recording:
    return cut(sparse_corridor(), SCANS)


def lines(recording: Recording) -> Iterator[str]:
    """The recording as another program would write it."""
    yield json.dumps({"type": "platform", **platform_of(recording).model_dump(mode="json")})
    for _, _, k, stream in messages(recording, {}):
        stamp = getattr(recording, stream).stamps[k]
        if stream == "lidar":
            ranges = [None if np.isnan(one) else float(one) for one in recording.lidar.ranges[k]]
            yield json.dumps({"type": "scan", "stamp": stamp, "ranges": ranges})
        elif stream == "encoders":
            counts = recording.encoders.counts[k].tolist()
            yield json.dumps({"type": "odometry", "stamp": stamp, "counts": counts})
        else:
            rate = float(recording.imu.angular_velocity[k, 2])
            yield json.dumps({"type": "imu", "stamp": stamp, "yaw_rate": rate})


def fed(monkeypatch: pytest.MonkeyPatch, text: str | bytes, *options: object) -> int:
    data = text.encode() if isinstance(text, str) else text
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(data)))
    return run(["replay", "--stdin", *map(str, options)])


def test_lines_of_json_give_the_result_of_the_recording(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = tmp_path / "out"
    text = "\n".join(lines(recording))
    assert fed(monkeypatch, text, "--out", out, "--set", "particles=3", "--seed", 4, "--no-figures") == 0
    updates = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    expected = run_slam(recording, resolve_config("default", ["particles=3"]), seed=4).trajectory
    np.testing.assert_array_equal([each["pose"] for each in updates], expected.poses[[e["index"] for e in updates]])
    assert [updates[-1]["index"], updates[-1]["state"]] == [SCANS - 1, "sure"]
    assert np.shape(updates[-1]["covariance"]) == (3, 3)
    assert (out / "trajectory.tum").read_text().count("\n") == SCANS + 1
    assert json.loads((out / "run.json").read_text())["warnings"] == []


BAD = {
    "not json": "",
    "[1]": "",
    '{"type": "laser", "stamp": 1}': "type",
    '{"type": "imu", "stamp": "x", "yaw_rate": 1}': "imu.stamp",
    '{"type": "imu", "stamp": NaN, "yaw_rate": 1}': "imu.stamp",
    '{"type": "imu", "stamp": 9e9, "yaw_rate": null}': "imu.yaw_rate",
    '{"type": "imu", "stamp": 1, "rate": 1}': "imu.rate",
    '{"type": "scan", "stamp": 9e9, "ranges": [1, 2]}': "ranges",
    '{"type": "scan", "stamp": 9e9}': "lidar.ranges",
    json.dumps({"type": "scan", "stamp": 1.7e9, "ranges": [1] * 271}): "lidar.stamp",
    '{"type": "odometry", "stamp": 9e9, "counts": [1]}': "odometry.counts",
    '{"type": "platform", "name": "late"}': "platform",
    "\x00" * 5_000_000: "",
}


def test_a_line_that_cannot_be_used_is_told_left_out_and_stops_nothing(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    good = list(lines(recording))
    for begin in range(0, len(BAD), 7):  # so many are told each in a line
        some = dict(list(BAD.items())[begin : begin + 7])
        text = "\n".join([*good[:40], *some, *good[40:]])
        assert fed(monkeypatch, text, "--set", "particles=3") == 0
        out, err = capsys.readouterr()
        assert json.loads(out.splitlines()[-1])["index"] == SCANS - 1
        told = [line for line in err.splitlines() if "left out" in line]
        for number, (field, line) in enumerate(zip(some.values(), told[:-1], strict=True), start=41):
            assert line.startswith(f"moteslam: warning: stdin:{number}: {field}"), line
        assert told[-1] == f"moteslam: warning: stdin: {len(some)} of {len(good) + len(some)} lines were left out"


@pytest.mark.parametrize("begins", [12.5, 1.7e9], ids=str)
def test_a_first_message_of_another_clock_is_told_and_left_out(
    begins: float, recording: Recording, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    robot, *good = lines(recording)
    early = json.dumps({"type": "scan", "stamp": begins, "ranges": [1] * 271})
    assert fed(monkeypatch, "\n".join([robot, early, *good]), "--set", "particles=3") == 0
    out, err = capsys.readouterr()
    assert json.loads(out.splitlines()[-1])["index"] == SCANS - 1
    told = [line for line in err.splitlines() if "left out" in line]
    assert told[0].startswith(f"moteslam: warning: stdin:2: scan.stamp: {begins} s")
    assert told[1:] == [f"moteslam: warning: stdin: 1 of {len(good) + 2} lines were left out"]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "stdin: 0 lines without a scan, expected some"),
        ('{"type": "imu", "stamp": 1, "yaw_rate": 1}', "platform.lidar: beams, angle_min, angle_increment"),
        ('{"type": "imu", "stamp": 1, "yaw_rate": 1}', "--platform NAME, or a first line of type platform"),
        ('{"type": "platform", "lidar": {"beams": 0}}', "stdin:1: lidar.beams: "),
    ],
)
def test_input_without_a_scan_or_a_lidar_is_refused(
    text: str, expected: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert fed(monkeypatch, text, "--out", tmp_path / "out") == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith("moteslam: ")
    assert expected in told
    assert not list(tmp_path.iterdir())


def test_options_of_a_recording_are_refused(capsys: pytest.CaptureFixture[str]) -> None:
    for more in (["robot.log"], ["--mcap"], ["--end", "3"], ["--dead-reckoning"]):
        assert run(["replay", "--stdin", *more]) == 2
        assert "--stdin" in capsys.readouterr().err
