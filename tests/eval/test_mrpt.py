"""The example that runs MRPT's SLAM: what it converts, what it refuses, and its specification."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec
from moteslam.robot.trajectories.text import read_tum

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SCRIPT = EXAMPLES / "mrpt_slam.py"
LOG = """# a log
PARAM robot_front_laser_max 30.0
ODOM 9 9 9 0 0 0 100.0 moteslam 100.0
ROBOTLASER1 0 -1.0 2.0 1.0 30.0 0.01 0 3 1.5 2.5 3.5 0 1.1 2.0 0.5 1.0 2.0 0.5 0 0 0 0 0 100.25 moteslam 100.25
ROBOTLASER1 0 -1.0 2.0 1.0 30.0 0.01 0 3 1.5 2.5 3.5 0 1.1 3.0 0.6 1.0 3.0 0.6 0 0 0 0 0 100.5 moteslam 100.5
"""


def run(folder: Path, *, method: str = "icp", log: str = LOG, path: str = "") -> subprocess.CompletedProcess[str]:
    """The script over a log, with the programs of a folder alone."""
    recording, out = folder / "recording.log", folder / "out"
    recording.write_text(log, encoding="utf-8")
    out.mkdir()
    words = [sys.executable, str(SCRIPT), "--method", method, "--recording", str(recording), "--out", str(out)]
    return subprocess.run(words, capture_output=True, text=True, check=False, env={"PATH": path})


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
