"""What command lines refuse: one line on stderr that names it, exit code 2, nothing written."""

from __future__ import annotations

from pathlib import Path

import pytest
from command_lines import refused
from made_sweeps import swept

TUM = "".join(f"{t} {t} 0 0 0 0 0 1\n" for t in range(10))
FAR_WALL = "[[world.walls]]\npoints = [[-90.0, -90.0], [-90.0, 90.0]]\n"
TRACKS = "EST... [REF]"

LINES = {
    "": [
        ("bogus", "No such command 'bogus'"),
        ("demo --seed 99999999999999999999", "--seed"),
        ("demo --set particles=0", "--set particles: "),
        ("demo --config absent.toml", "absent.toml: No such file"),
        ("replay", "PATH"),
        ("replay x --preset none", "--preset none: "),
        ("replay robot --every 0 --out x", "--every: 0, expected at least 1"),
    ],
    "simulate ": [
        ("random-corridors --out x --batch 2 --seed 9223372036854775807", "--seed: 9223372036854775807"),
        ("random-corridors-9223372036854775808 --out x", "no such building, expected a number up to"),
        ("wide.toml --true-map 0.001 --out x", "moteslam: --true-map: "),
        ("corridor --out robot", "robot: exists already; name a new folder, or replace it with --force\n"),
    ],
    "simulate room.toml --out new/and/x ": [
        ("--platform nobody", "--platform nobody: no robot of this name, expected one of lms200, rplidar_a1, "),
        ("--set noise.lidar.dropout=2", "room.toml: noise.lidar.dropout: "),
        ("--log-every nan", "--log-every: nan, expected a finite number above 0"),
        ("--odometry-noise 0.1 2", "--odometry-noise: 0.1 2, expected 0 to 1"),
    ],
    "scenarios ": [
        ("show lab --out there.png", "there.png: exists already"),
        ("show lab --out x.jpg", "x.jpg: expected a name"),
        ("animate lab --out x.gif --fps 51", "--fps: 51, expected"),
    ],
    "convert robot ": [
        ("a.log --start -1", "--start: -1 s, expected a finite time of at least 0"),
        ("a.log --streams laser", "--streams: 'laser', expected some of lidar, encoders, odometry, imu, rgbd"),
        ("a.log --topics lidar", "--topics: 'lidar', expected STREAM=TOPIC with a stream of lidar, odometry, "),
        ("a.log --topics lidar=/a --topics lidar=/b", "--topics: lidar twice, expected lidars to merge as "),
        ("a.log --topics lidar=/scan", "has no topics, expected no names of topics"),
        ("a.log --sequence 7", " (option --sequence)\n"),
        ("a.xyz", "--to: 'a.xyz' has the ending of no format, expected one of .log, .log.gz, .clf, "),
        ("a.log --to db3", "--to: 'db3' is only read, expected one of ucsd, carmen, csv, bag, rosbag2, mcap"),
    ],
    "convert ": [
        ("good.tum a.bag", "--to: good.tum is a trajectory: expected a name that ends in .csv, .g2o, .kitti, "),
        ("good.tum a.g2o --start 3", "--start: of a recording, expected none for a trajectory"),
        ("early.tum a.csv", "stamps: stamps below 0 or beyond 1e11 s, expected seconds between"),
    ],
    "evaluate good.tum ": [
        ("", f"'{TRACKS}': one file, expected trajectories and, last, their reference"),
        ("some.relations --no-align", "'--no-align': given without a reference trajectory"),
        ("--recording any.log --delta 1.0", "'--delta': given without a reference trajectory"),
        ("--recording any.log --max-difference 0.1", "'--max-difference': given without a reference"),
        ("truth.tum --sequence 20", "'--sequence': given without a recording"),
        ("truth.tum --scale --no-align", "'--scale': given with --no-align"),
        ("truth.tum --map mine.yaml", "'--map': given without --true-map"),
        ("truth.tum --true-map mine.yaml", "'--true-map': given without a --map"),
        ("good.tum truth.tum --map a.yaml --true-map b.yaml", "'--map': given with several EST"),
        ("truth.tum --map a.yaml --true-map b.yaml", "a.yaml: "),
        ("truth.tum --metric nothing", "--metric: 'nothing'"),
        ("truth.tum --delta nan", "--delta: nan m"),
        ("truth.tum --unit feet", "'--unit': 'feet' is not one of"),
    ],
    "sweep ": [
        ("spec.toml --shard 3/2", "--shard: "),
        ("spec.toml --time --workers 2", "--time: "),
        ("spec.toml --scheduler tcp://127.0.0.1:9 --workers 2", "--workers: "),
        ("particle", "particle: no specification of this name, expected one of corridor-suite-1, "),
        ("show spec.toml", "spec.toml: no file of a sweep"),
        ("show a.sweep --metric ate", "--metric: 'ate', which was not measured, expected one of final.ate"),
        ("export empty.sweep --out y.csv", "empty.sweep: is empty"),
        ("export a.sweep --out x.csv", "x.csv: exists already"),
        ("diff a.sweep x.csv", "expected a table that `moteslam sweep export` wrote"),
    ],
    "sweep plot a.sweep --out ": [
        ("there.png", "there.png: exists already"),
        ("b.png --x seed", "--x: 'seed', expected one of scenario, configuration"),
        ("b.png --metric map_f1", "a.sweep: no run that ended well has map_f1"),
        ("b.png --metric mapf1", "'mapf1', expected one of"),
    ],
    "report ": [
        ("nowhere", "nowhere: there is no such file or folder"),
        ("empty", "empty: no result folder and no .sweep file in it"),
        ("a.sweep --metric nees", "--metric: 'nees', which no run has"),
        ("a.sweep --baseline x", "--baseline: 'x', expected one of"),
        ("a.sweep --out there.html", "there.html: exists already"),
    ],
    "compare ": [
        ("a.sweep --baseline best", "'best', expected one of 'plain, slam.tracking.window=1.0', "),
        ("a.sweep --metric final.aet", "expected one of ate"),
        ("no.sweep", "there is no such file"),
        ("a.sweep empty", "metrics.json"),
        ("one", "1 configuration, expected two"),
    ],
}


@pytest.fixture(scope="module")
def here(simulated_folder: Path, scenario_file: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with what the lines name."""
    folder = tmp_path_factory.mktemp("here")
    room = scenario_file.read_text()
    (folder / "robot").symlink_to(simulated_folder)
    for name in ("empty", "one"):
        (folder / name).mkdir()
    swept(folder)
    for name, text in {
        "room.toml": room,
        "wide.toml": room + FAR_WALL,
        "there.png": "",
        "there.html": "",
        "good.tum": TUM,
        "truth.tum": TUM,
        "early.tum": "-1 0 0 0 0 0 0 1\n1 0 0 0 0 0 0 1\n",
        "some.relations": "1 2 1 0 0 0 0 0\n",
        "spec.toml": 'scenarios = ["corridor"]\n',
        "empty.sweep": "",
        "x.csv": "a,b\n1,2\n",
        "one/metrics.json": '{"metrics": {}}',
        "one/run.json": "{}",
    }.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.parametrize(
    ("line", "words"), [(command + line, words) for command, lines in LINES.items() for line, words in lines]
)
def test_one_line_and_exit_code_2(line: str, words: str, here: Path, monkeypatch: pytest.MonkeyPatch, capsys) -> None:
    monkeypatch.chdir(here)
    before = sorted(here.rglob("*"))
    assert words in refused(capsys, *line.split())
    assert sorted(here.rglob("*")) == before
