"""Ways to run: messages on stdin, a known map, a lidar that is not as stated; and the issues that are told."""

import io
import json
import re
import shutil
import signal
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from command_lines import Capsys, codes, printed, refused, shown
from made_bags import make_bag, odometry, placed, rolled, scan
from parts.runs import messages
from robot_logs import flaser, write_log
from sim_logs import winding
from slam_messages import cut, platform_of, sparse_corridor

from moteslam.eval.cli.main import run
from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.robot.formats import open_recording, write_recording
from moteslam.robot.formats.map_server import write_map
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum, write_tum
from moteslam.sim.logged import with_odometry
from moteslam.sim.output import write_simulation
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.inputs.synchronise import dead_reckon
from moteslam.slam.online import OnlineSlam, run_slam
from moteslam.slam.scan_records import Update

SCANS = 60


@pytest.fixture(scope="module")
def recording() -> Recording:
    return cut(sparse_corridor(), SCANS)


def lines(recording: Recording) -> Iterator[str]:
    """The recording as another program would write it."""
    yield json.dumps({"type": "platform", **platform_of(recording).model_dump(mode="json")})
    for _, _, stream, k in messages(recording, {}):
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
    recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Capsys
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


@pytest.mark.parametrize(("asked", "code"), [(1, 0), (2, 130)], ids=["once", "twice"])
@pytest.mark.usefixtures("signals_are_heard")
def test_ctrl_c_ends_the_input_and_a_second_the_run(
    asked: int, code: int, recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Capsys
) -> None:
    class Driver(io.BytesIO):
        def readline(self, size: int | None = -1) -> bytes:
            line = super().readline(size)
            if not line:  # a driver that goes on has nothing to say now
                signal.raise_signal(signal.SIGINT)
                pytest.fail("still waiting")
            return line

    def finish(slam: OnlineSlam, usual: Callable[[OnlineSlam], Update | None] = OnlineSlam.finish) -> Update | None:
        for _ in range(asked - 1):
            signal.raise_signal(signal.SIGINT)
        return usual(slam)

    monkeypatch.setattr(OnlineSlam, "finish", finish)
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=Driver("\n".join(lines(recording)).encode())))
    options = ["--set", "particles=3", "--no-figures", "--out", str(tmp_path / "out")]
    assert run(["replay", "--stdin", *options]) == code
    told = capsys.readouterr().err.splitlines()
    assert told[0].startswith("moteslam: interrupted: the input ends here")
    assert len(told) == 2
    assert (tmp_path / "out/trajectory.tum").exists() == (code == 0)
    assert len(list(tmp_path.iterdir())) == (code == 0)


BAD = {
    "not json": "",
    '{"type": "laser", "stamp": 1}': "type",
    '{"type": "imu", "stamp": "x", "yaw_rate": 1}': "imu.stamp",
    '{"type": "imu", "stamp": 1, "rate": 1}': "imu.rate",
    '{"type": "scan", "stamp": 9e9}': "scan.ranges: missing",
    '{"type": "platform", "name": "late"}': "platform",
    "\x00" * 5_000_000: "",
}


def test_a_line_that_cannot_be_used_is_told_left_out_and_stops_nothing(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, capsys: Capsys
) -> None:
    good = list(lines(recording))
    assert fed(monkeypatch, "\n".join([*good[:40], *BAD, *good[40:]]), "--set", "particles=3") == 0
    out, err = capsys.readouterr()
    assert json.loads(out.splitlines()[-1])["index"] == SCANS - 1
    told = [line for line in err.splitlines() if "left out" in line]
    for number, (field, line) in enumerate(zip(BAD.values(), told[:-1], strict=True), start=41):
        assert line.startswith(f"moteslam: warning: stdin:{number}: {field}"), line
    assert told[-1] == f"moteslam: warning: stdin: {len(BAD)} of {len(good) + len(BAD)} lines were left out"


@pytest.mark.parametrize(
    ("begins", "first"),
    [(12.5, {"type": "scan", "ranges": [1] * 271}), (1.7e9, {"type": "odometry", "counts": [9] * 4})],
)
def test_a_first_message_of_another_clock_is_told_and_left_out(
    begins: float, first: dict, recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    robot, *good = lines(recording)
    text, out = "\n".join([robot, json.dumps({**first, "stamp": begins}), *good]), tmp_path / "out"
    assert fed(monkeypatch, text, "--set", "particles=3", "--out", out, "--no-figures") == 0
    (told,) = json.loads((out / "run.json").read_text())["warnings"]
    assert told["code"] == "other-clock"
    assert str(begins) in told["message"]
    expected = run_slam(recording, resolve_config("default", ["particles=3"])).trajectory
    np.testing.assert_allclose(read_tum(out / "trajectory.tum").poses, expected.poses, atol=1e-8)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", "stdin: 0 lines without a scan, expected some"),
        ('{"type": "imu", "stamp": 1, "yaw_rate": 1}', "--platform NAME, or a first line of type platform"),
        ('{"type": "platform", "lidar": {"beams": 0}}', "stdin:1: lidar.beams: "),
    ],
)
def test_input_without_a_scan_or_a_lidar_is_refused(
    text: str, expected: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Capsys
) -> None:
    assert fed(monkeypatch, text, "--out", tmp_path / "out") == 2
    told = capsys.readouterr().err.splitlines()[-1]
    assert told.startswith("moteslam: ")
    assert expected in told
    assert not list(tmp_path.iterdir())


@pytest.fixture(scope="module")
def drive(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short drive with its truth, and the true map beside it."""
    folder = tmp_path_factory.mktemp("drive")
    simulation: Simulation = simulate(scenario_of("corridor", 200, platform="turtlebot3", duration=15.0), 200)
    write_simulation(folder / "log", simulation)
    write_map(folder / "map.pgm", simulation.true_map(0.05))
    return folder


@pytest.mark.slow
def test_replay_says_what_is_doubtful_in_its_truth(drive: Path, tmp_path: Path, capsys: Capsys) -> None:
    shutil.copytree(drive / "log", tmp_path / "log")
    truth = read_tum(drive / "log" / "truth.tum")
    write_tum(tmp_path / "log" / "truth.tum", replace(truth, stamps=truth.stamps + 0.2))
    printed(capsys, "replay", tmp_path / "log", "--out", tmp_path / "out", "--no-figures")
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert "clocks-differ" in [issue["code"] for issue in run["warnings"]]


@pytest.mark.slow
def test_poses_are_in_the_frame_of_the_map_which_does_not_change(drive: Path, tmp_path: Path, capsys: Capsys) -> None:
    out = tmp_path / "found"
    printed(capsys, "localize", drive / "log", "--map", drive / "map.yaml", "--out", out)
    found, truth = read_tum(out / "trajectory.tum"), read_tum(drive / "log" / "truth.tum")
    at = np.searchsorted(truth.stamps, found.stamps).clip(max=len(truth) - 1)
    assert np.abs(found.poses[:, :2] - truth.poses[at, :2]).max() < 0.1
    assert (out / "map.pgm").read_bytes() == (drive / "map.pgm").read_bytes()
    assert json.loads((out / "metrics.json").read_text())["localisation"]["states"]["lost"] == 0
    # a result folder is a map, too
    printed(capsys, "localize", drive / "log", "--map", out, "--out", tmp_path / "again", "--no-figures")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (("--map", "nowhere.yaml"), "nowhere.yaml"),
        (("--map", "log"), "log is a recording, expected the .yaml file of a map, or the result folder of a run"),
        (("--map", "map.pgm"), "expected the .yaml file of this image, or a result folder"),
        (("--map", "map.yaml", "--preset", "default"), "--set known_map"),
        (("--map", "map.yaml", "--near", "0", "0", "90", "0.5"), "--near: a heading of 90, expected radians"),
        (("--map", "map.yaml", "--near", "0", "0", "0", "-1"), "--near: a standard deviation of -1 m"),
        (
            ("--map", "map.yaml", "--near", "200", "0", "0", "0.5"),
            "m outside of the map, expected a place in it, or near",
        ),
    ],
)
def test_bad_input_is_one_line(
    drive: Path, tmp_path: Path, capsys: Capsys, arguments: tuple[str, ...], says: str
) -> None:
    words = [drive / word if word.startswith(("nowhere", "map.", "log")) else word for word in arguments]
    assert says in refused(capsys, "localize", drive / "log", *words, "--out", tmp_path / "out")
    assert not (tmp_path / "out").exists()


@pytest.fixture(scope="module")
def office() -> Simulation:
    return simulate(load_scenario("office", platform="lms200"), 200)


@pytest.fixture(scope="module")
def reversed_beams(office: Simulation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of a drive whose scans have their beams the other way round."""
    folder = tmp_path_factory.mktemp("logs")
    recording = office.recording
    lidar = recording.lidar
    poses = dead_reckon(recording).poses
    ranges = np.ascontiguousarray(lidar.ranges[:, ::-1])
    write_carmen(folder / "drive.log", recording.replace(lidar=replace(lidar, ranges=ranges, odometry=poses)))
    write_tum(folder / "drive.tum", office.truth)
    return folder / "drive.log"


@pytest.mark.slow
def test_inspect_gives_estimates_and_what_is_certain(reversed_beams: Path, capsys: Capsys) -> None:
    found = shown(capsys, "inspect", reversed_beams)
    assert "mirrored" in [problem["code"] for problem in found["problems"]]
    assert {"name", "value", "deviation", "stated", "certain"} == found["calibration"][0].keys()


@pytest.mark.slow
def test_inspect_says_all_that_replay_says_of_a_bag(tmp_path: Path, capsys: Capsys) -> None:
    recording = with_odometry(winding(seconds=12.0)).replace(encoders=None, imu=None)
    odometry = recording.odometry
    poses = odometry.poses.copy()
    frozen = (odometry.stamps > odometry.stamps[0] + 4) & (odometry.stamps < odometry.stamps[0] + 7)
    poses[frozen] = poses[frozen][0]
    bag = tmp_path / "drive.mcap"
    write_recording(bag, recording.replace(odometry=replace(odometry, poses=poses)))
    cheap = ("--preset", "paper", "--set", "particles=3", "--no-figures")
    warnings = codes(capsys, "replay", bag, "--out", tmp_path / "out", *cheap)
    assert "stale-odometry" in warnings
    assert "lost" in warnings  # of the filter, not of the bag
    assert {*warnings} - {"lost"} <= set(codes(capsys, "inspect", bag))


@pytest.mark.slow
@pytest.mark.parametrize(("scale", "expected"), [(1.0, {"travels-along"}), (1.06, {"lidar-angles"})])
def test_what_travels_along_is_known_only_where_the_angles_are_right(
    office: Simulation, tmp_path: Path, capsys: Capsys, scale: float, expected: set[str]
) -> None:
    recording = with_odometry(office.recording)
    lidar = recording.lidar
    keep = np.arange(400)
    ranges = np.array(lidar.ranges[keep])
    ranges[:, 80:90] = 0.5  # a load
    step = lidar.angle_increment / scale
    lidar = replace(lidar, stamps=lidar.stamps[keep], ranges=ranges, angle_increment=step, odometry=None)
    write_recording(tmp_path / "drive.mcap", recording.replace(lidar=lidar, encoders=None, imu=None))
    asked, bag = {"lidar-angles", "travels-along"}, tmp_path / "drive.mcap"
    cheap = ("--no-figures", "--set", "particles=5")
    for command in (("inspect", bag, "--deep"), ("replay", bag, "--out", tmp_path / "out", *cheap)):
        assert asked.intersection(codes(capsys, *command)) == expected


@pytest.mark.slow
def test_replay_warns_and_mends(reversed_beams: Path, tmp_path: Path, capsys: Capsys) -> None:
    for name, options in (("as_is", []), ("mended", ["--calibrate", "lidar"])):
        out = str(tmp_path / name)
        cheap = ("--no-figures", "--set", "particles=5")
        warnings = shown(capsys, "replay", reversed_beams, "--out", out, *cheap, *options)["warnings"]
        (mirrored,) = [issue["message"] for issue in warnings if issue["code"] == "mirrored"]
        assert mirrored.endswith("; mended in the lidar's figures") == bool(options)
    truth = read_tum(reversed_beams.with_suffix(".tum"))
    as_is, mended = (
        absolute_trajectory_error(read_tum(tmp_path / name / "trajectory_final.tum"), truth).rmse
        for name in ("as_is", "mended")
    )
    assert mended < 0.1 < as_is


@pytest.mark.slow
def test_a_fault_that_another_one_hides_is_mended_too(tmp_path: Path, capsys: Capsys) -> None:
    drive = simulate(load_scenario("office", platform="rplidar_a1"), 7)
    lidar = drive.recording.lidar
    ends = lidar.stamps + lidar.time_increment * lidar.ranges.shape[1]  # which no sweep is known to begin before
    platform = drive.recording.platform
    plain = platform.model_copy(update={"lidar": platform.lidar.model_copy(update={"time_increment": 0.0})})
    wrong = drive.recording.replace(lidar=replace(lidar, stamps=ends, time_increment=0.0), platform=plain)
    write_recording(tmp_path / "drive.mcap", wrong)
    cheap = ("--no-figures", "--set", "particles=5", "--calibrate", "lidar")
    warnings = shown(capsys, "replay", tmp_path / "drive.mcap", "--out", tmp_path / "out", *cheap)["warnings"]
    assert {"time-increment", "clock-offset"} <= {issue["code"] for issue in warnings}
    path = read_tum(tmp_path / "out" / "trajectory_final.tum")
    assert absolute_trajectory_error(path, drive.truth).rmse < 0.02


ROOT = Path(__file__).parents[2]


def test_text_json_and_python_have_the_same_issues(tmp_path: Path, capsys: Capsys) -> None:
    ranges = np.full(181, 3.0)
    lines = [flaser([-1.0, *(ranges[1:] + k / 100)], stamp=k / 5, robot=(k / 20, 0.0, 0.0)) for k in range(8)]
    log = write_log(tmp_path / "a.log", [*lines, "FLASER 181 1.0", "FLASER x"])
    assert run(["replay", str(log), "--out", str(tmp_path / "out"), "--no-figures", "--json"]) == 0
    out, err = capsys.readouterr()
    issues = json.loads(out)["warnings"]
    assert [(issue["code"], issue["count"]) for issue in issues] == [("broken-lines", 2), ("invalid-ranges", 8)]
    assert [line for line in err.splitlines() if "warning" in line] == [
        f"moteslam: warning: {issue['message']}" for issue in issues
    ]
    assert json.loads((tmp_path / "out" / "run.json").read_text())["warnings"] == issues
    recording = open_recording(log)
    assert [issue.as_dict() for issue in recording.warnings] == issues
    assert shown(capsys, "inspect", log)["problems"][:2] == issues


def test_every_code_is_documented() -> None:
    sources = [path for folder in ("robot", "slam", "eval", "sim") for path in (ROOT / folder).rglob("*.py")]
    text = "\n".join(path.read_text("utf-8") for path in sources)
    given = set(re.findall(r'(?:Issue|tell|told\.append\()\(\s*"([a-z-]+)"', text))
    page = (ROOT / "docs" / "reference" / "formats.md").read_text("utf-8")
    table = page.partition("## Warnings")[2].partition("## Bounds")[0]
    documented = set(
        re.findall(r"`([a-z-]+)`", "\n".join(line.split("|")[1] for line in table.splitlines() if "| " in line))
    ) - {"code"}
    assert given <= documented
    assert {code for code in documented if f'"{code}"' not in text} == set()


def test_units_in_which_nothing_is_left_end_the_run_and_are_no_broken_line(
    recording: Recording, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: Capsys
) -> None:
    long = recording.replace(lidar=replace(recording.lidar, ranges=recording.lidar.ranges * np.float32(1e3)))
    assert fed(monkeypatch, "\n".join(lines(long)), "--out", tmp_path / "out") == 2
    told = capsys.readouterr().err.splitlines()
    assert told[-1].startswith("moteslam: stdin: lidar: the median of its ranges is")
    assert not [line for line in told if "left out" in line]
    assert not list(tmp_path.iterdir())


def test_options_of_a_recording_are_refused(capsys: Capsys) -> None:
    for more in (["robot.log"], ["--mcap"], ["--end", "3"], ["--dead-reckoning"]):
        assert "--stdin" in refused(capsys, "replay", "--stdin", *more)


def test_inspect_says_where_nothing_could_be_measured(tmp_path: Path, capsys: Capsys) -> None:
    write_recording(tmp_path / "short.mcap", winding(seconds=1.0).replace(encoders=None, imu=None))
    said = printed(capsys, "inspect", bag := tmp_path / "short.mcap")
    assert "by scans and odometry: nothing measured" in said
    assert re.search(r"^dropouts +- ", said, re.MULTILINE) is not None
    assert said.count("--deep") == 1
    assert said.endswith("only with --deep: nearest and farthest endpoint, noise, dropouts (-)\n")
    assert "--deep" not in printed(capsys, "inspect", bag, "--deep")


@pytest.mark.slow
def test_of_lidars_that_are_read_as_one_the_wrong_one_is_named(
    office: Simulation, tmp_path: Path, capsys: Capsys
) -> None:
    made = office.recording
    path, mount, at = dead_reckon(made.replace(lidar=None)), made.platform.lidar, made.lidar
    t0, figures = path.stamps[0], {"angle_min": at.angle_min, "angle_max": -at.angle_min, "range_max": at.range_max}
    events = [odometry(t - t0, pose) for t, pose in zip(path.stamps[::3], path.poses[::3].tolist(), strict=True)]
    for name, off in (("right", 0.0), ("wrong", 0.3)):
        events.append(placed(0, "base_link", name, (mount.x + off, mount.y, 0.2), turn=rolled(0.0, mount.yaw)))
        events += [
            scan(t - t0, ranges, topic=f"/{name}", frame=name, **figures, angle_increment=at.angle_increment)
            for t, ranges in zip(at.stamps[::5], at.ranges[::5], strict=True)
        ]
    bag = make_bag(tmp_path, events)
    said = printed(capsys, "inspect", bag, "--topics", "lidar=/right,/wrong").splitlines()
    told = [line for line in said if line.startswith("problem: /")]
    assert len(told) == 1
    assert told[0].startswith("problem: /wrong: ")
    assert '[lidars."/wrong"] x = ' in told[0]
