"""The example that runs MRPT's SLAM: what it converts, what it refuses, and a run where the programs are installed."""

from __future__ import annotations

import math
import re
import shutil
import struct
import subprocess
import sys
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest
from scripts import loaded

from moteslam.eval.sweep.external import Command, estimate
from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, read_map
from moteslam.robot.pictures import encode_png
from moteslam.robot.trajectories.tum import read_tum

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SCRIPT = EXAMPLES / "mrpt_slam.py"
LOG = """# a log
PARAM robot_front_laser_max 30.0
ODOM 9 9 9 0 0 0 100.0 moteslam 100.0
ROBOTLASER1 0 -1.0 2.0 1.0 30.0 0.01 0 3 1.5 2.5 3.5 0 1.1 2.0 0.5 1.0 2.0 0.5 0 0 0 0 0 100.25 moteslam 100.25
ROBOTLASER1 0 -1.0 2.0 1.0 30.0 0.01 0 3 1.5 2.5 3.5 0 1.1 3.0 0.6 1.0 3.0 0.6 0 0 0 0 0 100.5 moteslam 100.5
"""


@pytest.fixture(scope="module")
def example() -> ModuleType:
    """The script as a module."""
    return loaded("docs/examples/mrpt_slam.py")


def run(folder: Path, *, method: str = "icp", log: str = LOG, path: str = "") -> subprocess.CompletedProcess[str]:
    """The script over a log, with the programs of a folder alone."""
    recording, out = folder / "recording.log", folder / "out"
    recording.write_text(log, encoding="utf-8")
    out.mkdir()
    words = [sys.executable, str(SCRIPT), "--method", method, "--recording", str(recording), "--out", str(out)]
    return subprocess.run(words, capture_output=True, text=True, check=False, env={"PATH": path})


def test_scans_of_a_log_have_their_stamps_and_odometry(example: ModuleType) -> None:
    assert example.read_log(LOG) == [(100.25, (1.0, 2.0, 0.5)), (100.5, (1.0, 3.0, 0.6))]
    with pytest.raises(example.SlamError, match="no ROBOTLASER1 line"):
        example.read_log("ODOM 9 9 9 0 0 0 100.0 moteslam 100.0\n")


def test_pairs_of_a_rawlog_have_the_logs_stamps_and_movements(example: ModuleType) -> None:
    def scan(content: bytes) -> bytes:
        return example.SCAN + b"\x07" + content + bytes(8) + b"wide" + example.LABEL + b"\x88"

    odometry = example.ODOMETRY + b"\x02pose\x08\x00\x00\x00ODOMETRY\x88"
    rawlog = b"".join(odometry + scan(content) for content in (b"first", b"second", b"third"))
    scans = [(100.25, (1.0, 2.0, math.pi / 2)), (100.5, (0.5, 3.0, -math.pi)), (100.75, (0.0, 3.25, -3.0))]
    pairs = example.as_pairs(rawlog, scans)
    first, second, third = (struct.pack("<Q", round(stamp * 1e7) + 116_444_736_000_000_000) for stamp, _ in scans)
    assert pairs.count(b"CActionCollection") == 3
    assert b"first" + first + b"wide" in pairs
    assert b"second" + second + b"wide" in pairs
    assert b"third" + third + b"wide" in pairs
    assert b"ODOMETRY" not in pairs
    moved = [struct.unpack_from("<3d", pairs, at + len(b"CPose2D\x01")) for at in example._finds(pairs, b"CPose2D\x01")]
    np.testing.assert_allclose(moved, [(0, 0, 0), (1, 0.5, math.pi / 2), (0.5, -0.25, math.pi - 3)], atol=1e-12)
    with pytest.raises(example.SlamError, match="wrote 3 scans, expected the 1 of the recording"):
        example.as_pairs(rawlog, scans[:1])
    with pytest.raises(example.SlamError, match="a scan of another form"):
        example.as_pairs(rawlog.replace(b"ROBOTLASER1", b"SICK_LMS_00"), scans)


@pytest.mark.parametrize(
    ("method", "path"),
    [
        ("icp", "0 1.0 2.0 0.5\n1 1.5 2.5 -3.0\n"),
        ("rbpf", "% step x y z yaw\n0 1.0 2.0 0.0 0.5 0.0 0.0 7.0\n1 1.5 2.5 0.0 -3.0 0.0 0.0 8.0\n"),
    ],
)
def test_a_path_becomes_a_trajectory(method: str, path: str, example: ModuleType, tmp_path: Path) -> None:
    file = tmp_path / "path.tum"
    file.write_text(example.as_tum(path, [100.25, 100.5], example.YAW[method]), encoding="utf-8")
    trajectory = read_tum(file)
    np.testing.assert_array_equal(trajectory.stamps, [100.25, 100.5])
    np.testing.assert_allclose(trajectory.poses, [(1, 2, 0.5), (1.5, 2.5, -3)], atol=1e-12)
    with pytest.raises(example.SlamError, match=r"2 poses in log_estimated_path\.txt, expected 3"):
        example.as_tum(path, [100.25, 100.5, 100.75], example.YAW[method])


def test_the_limits_of_a_grid_place_its_image(example: ModuleType, tmp_path: Path) -> None:
    """Two rows: the upper one of the image, at the larger y, has a wall; what nobody saw is 127 or 128."""
    picture = np.array([[0, 255, 127], [255, 255, 128]], np.uint8)
    (tmp_path / "map.png").write_bytes(encode_png(picture))
    text = example.as_yaml("% Grid limits: [x_min x_max y_min y_max]\n-2.0 -1.85 3.0 3.1\n", "map.png")
    (tmp_path / "map.yaml").write_text(text, encoding="utf-8")
    found = read_map(tmp_path / "map.yaml")
    assert found.extent == pytest.approx((-2.0, -1.85, 3.0, 3.1))
    np.testing.assert_array_equal(found.values, [(FREE, FREE, UNKNOWN), (OCCUPIED, FREE, UNKNOWN)])
    with pytest.raises(example.SlamError, match="3 words in the limits"):
        example.as_yaml("-2.0 1.0 3.0", "map.png")


def test_the_ini_file_has_sections_and_the_seed(example: ModuleType) -> None:
    assert example.as_ini({"A": {"x": 1, "y": "b"}, "B": {}}) == "[A]\nx = 1\ny = b\n\n[B]\n"
    assert "RANDOM_SEED = 7\n" in example.as_ini(example.settings("rbpf", 7))
    assert "[ICP]\n" in example.as_ini(example.settings("icp", 7))


def test_odometry_needs_no_program_and_is_that_of_the_log(tmp_path: Path) -> None:
    assert run(tmp_path, method="odometry").returncode == 0
    found = read_tum(tmp_path / "out" / "trajectory.tum")
    np.testing.assert_allclose(found.poses, [(1, 2, 0.5), (1, 3, 0.6)], atol=1e-12)


def test_what_goes_wrong_is_one_line(tmp_path: Path) -> None:
    missing, failing, empty = (tmp_path / name for name in ("missing", "failing", "empty"))
    for folder in (missing, failing, empty):
        folder.mkdir()
    program = failing / "carmen2rawlog"
    program.write_text("#!/bin/sh\necho something before >&2\necho no disk >&2\nexit 3\n", encoding="utf-8")
    program.chmod(0o755)
    for folder, log, problem in (
        (missing, LOG, "carmen2rawlog: No such file or directory, expected Debian's package mrpt-apps installed"),
        (failing, LOG, "carmen2rawlog ended with exit code 3: no disk"),
        (empty, "", "no ROBOTLASER1 line in the recording"),
    ):
        done = run(folder, log=log, path=str(folder))
        assert done.returncode == 2
        assert problem in done.stderr
        assert len(done.stderr.splitlines()) == 1


def test_the_examples_specification_is_a_sweep(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    query = tmp_path / "dpkg-query"
    query.write_text("#!/bin/sh\necho 1:2.5.8\n", encoding="utf-8")
    query.chmod(0o755)
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":")
    runs = plan(read_spec(EXAMPLES / "mrpt.toml"))
    assert len(runs) == 2 * 5 * 4
    ours = [run for run in runs if run.configuration == "icp"]
    assert {run.version for run in ours} == {"1:2.5.8"}
    assert {run.command[0][1] for run in ours} == {str(SCRIPT)}


def test_the_configurations_of_the_page_can_be_read(tmp_path: Path) -> None:
    page = (EXAMPLES.parent / "guide" / "external.md").read_text(encoding="utf-8")
    blocks = re.findall(r"```toml\n(.*?)```", page, re.S)
    assert len(blocks) == 2
    for text in blocks:
        spec = tmp_path / "spec.toml"
        given = re.sub(r"^version = .*$", 'version = "1"', text, flags=re.M)
        spec.write_text(f'scenarios = ["corridor"]\nseeds = "0"\n{given}', encoding="utf-8")
        assert [run.version for run in plan(read_spec(spec))] == ["1"]


@pytest.mark.slow
@pytest.mark.parametrize("method", ["icp", "rbpf"])
def test_mrpt_is_better_than_dead_reckoning(method: str) -> None:
    """Over a drive without a gyro; its map lies on the true one, neither mirrored nor shifted."""
    from moteslam.eval.metrics.evidence import FINAL, Evidence
    from moteslam.eval.metrics.registry import measure
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.simulate import simulate

    programs = ("carmen2rawlog", "icp-slam", "rbpf-slam")
    if missing := [name for name in programs if shutil.which(name) is None]:
        pytest.skip(f"no {missing[0]}: Debian's package mrpt-apps")
    scenario = load_scenario("corridor", noise="as_recorded", settings=("platform.imu=false",))
    simulation = simulate(scenario.model_copy(update={"duration": 20.0}), seed=101)
    words = (
        sys.executable,
        str(SCRIPT),
        "--recording",
        "{recording}",
        "--out",
        "{out}",
        "--seed",
        "{seed}",
        "--method",
    )
    errors = {}
    for name in ("odometry", method):
        command = Command((*words, name), "carmen", "trajectory.tum", "map.yaml")
        trajectory, occupancy = estimate(command, simulation.recording, 0)
        evidence = Evidence(
            {FINAL: trajectory},
            truth=simulation.truth,
            occupancy=occupancy,
            true_map=simulation.true_map(0.05),
            recording=simulation.recording,
        )
        found = measure(evidence, ("final.ate", "map_f1"))
        errors[name] = found["final.ate"].number or 0.0
    assert (found["map_f1"].number or 0.0) > 0.75
    assert 0 < errors[method] < 0.06
    assert errors[method] < 0.6 * errors["odometry"]
