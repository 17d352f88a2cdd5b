"""The scripts of examples/ run, and each draws its picture."""

import ast
import gzip
import subprocess
import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

import moteslam

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST = {  # what ``main`` returns, at least and at most
    "closed_loop": (20.0, 30.0),
    "online": (0.0, 0.05),
    "my_weight_update": (20.0, 90.0),
    "score_my_trajectory": (0.02, 0.2),
    "real_log": (10.0, 60.0),
    "which_lidar": (0.0, 0.1),
}


def test_every_script_is_run_here():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*MOST, "ros2_node"}


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("name", MOST)
def test_a_script_draws_its_picture(name: str, tmp_path: Path):
    import matplotlib

    matplotlib.use("agg")
    found = import_module(name).main(tmp_path)
    assert (tmp_path / f"{name}.png").stat().st_size > 5000
    least, most = MOST[name]
    assert all(least < each < most for each in (found.values() if isinstance(found, dict) else [found]))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_the_public_names_that_a_script_uses_exist_and_it_is_short(path: Path):
    text = path.read_text(encoding="utf-8")
    named = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
    used = {node.attr for node in named if isinstance(node.value, ast.Name) and node.value.id == "moteslam"}
    assert used <= {name for names in moteslam.PUBLIC.values() for name in names}
    assert text.count("\n") <= 110


PROGRAMS = {  # what those of MRPT 2.5.8 leave behind
    "ros-map-yaml2mrpt": "touch room.gridmap.gz",
    "carmen2rawlog": 'cp {folder}/given.gz "${{@: -1}}"',
    "pf-localization": "for k in 1 2; do"
    ' echo "[INFO] PDF estimation: (1.500,-2.000,90.00deg), ESS (B.R.)= 1 tr(cov): 0.0$k"; done',
}


@pytest.mark.parametrize("installed", [True, False])
def test_localisation_of_mrpt_gives_a_pose_a_scan(installed: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("PATH", str(tmp_path), prepend=":" if installed else None)
    for name, script in PROGRAMS.items() if installed else ():
        (tmp_path / name).write_text(f"#!/bin/bash\n{script.format(folder=tmp_path)}\n", encoding="utf-8")
        (tmp_path / name).chmod(0o755)
    scan = b"\xa2mrpt::obs::CObservation2DRangeScan" + bytes(40) + b"\x0b\x00\x00\x00ROBOTLASER1"
    (tmp_path / "given.gz").write_bytes(gzip.compress(2 * scan))
    lines = [f"ROBOTLASER1 0 -1 3 1 30 0.01 0 1 2 0 0 0 0 {k} 0 0 0 0 0 0 0 {5 + k}.0 host 0\n" for k in range(2)]
    (tmp_path / "robot.log").write_text("".join(lines), encoding="utf-8")
    script = EXAMPLES / "external/mrpt_localize.py"
    words = ["--recording", tmp_path / "robot.log", "--map", "room.yaml", "--out", tmp_path, "--start", "1", "2", "0"]
    done = subprocess.run([sys.executable, script, *words], capture_output=True, text=True, check=False)
    if not installed:
        assert (done.returncode, done.stderr.count("\n"), "ros-map-yaml2mrpt" in done.stderr) == (2, 1, True)
        return
    assert done.returncode == 0, done.stderr
    half = 0.5**0.5
    found = np.loadtxt(tmp_path / "trajectory.tum")
    np.testing.assert_allclose(found, [(stamp, 1.5, -2, 0, 0, 0, half, half) for stamp in (5, 6)])
    assert (tmp_path / "spread.txt").read_text(encoding="utf-8") == "0.01\n0.02\n"
    assert "init_PDF_max_x = 1.5" in (tmp_path / "localize.ini").read_text(encoding="utf-8")
