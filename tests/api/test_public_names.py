"""The package's root: public names, errors of one line, and values of a wrong type."""

import json
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal

import moteslam
from moteslam import Platform, Recording, Trajectory
from moteslam.errors import ConfigError, InputError, MoteslamError, OutputError

HEAVY = ("taichi", "numpy", "scipy", "matplotlib", "pymunk", "shapely", "cv2", "pydantic", "typer", "rich")


def test_importing_the_package_and_its_errors_imports_nothing_heavy_and_lists_the_names():
    names = "assert set(moteslam.__all__) <= set(dir(moteslam))"
    code = f"import moteslam\nfrom moteslam import MoteslamError, InputError\n{names}"
    script = f"{code}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    loaded = set(json.loads(run.stdout.splitlines()[-1]))
    assert "moteslam" in loaded
    assert not loaded.intersection(HEAVY)


def test_every_public_name_is_there_and_says_what_it_is():
    for name in moteslam.__all__:
        assert name.startswith("__") or (getattr(moteslam, name).__doc__ or "").strip(), name


def test_an_unknown_name_is_an_attribute_error_that_names_it():
    with pytest.raises(AttributeError, match="no attribute 'slamm'"):
        moteslam.slamm  # noqa: B018


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MoteslamError("no poses"), "no poses"),
        (InputError("no poses", file=Path("run/a.tum")), "run/a.tum: no poses"),
        (InputError("expected 8 numbers", file="a.tum", line=3), "a.tum:3: expected 8 numbers"),
        (ConfigError("0, expected 1 or more", field="particles"), "particles: 0, expected 1 or more"),
        (OutputError("a\nb\u2028c", file="x\ry.bag"), "x\\ny.bag: a\\nb\\nc"),
    ],
)
def test_an_error_is_one_line_of_file_field_and_problem(error: MoteslamError, line: str):
    assert str(error) == line


PATH = Trajectory(np.arange(3.0), np.zeros((3, 3)))
EMPTY = Recording("empty", Platform())


@pytest.mark.parametrize(
    ("call", "parameter"),
    [
        (lambda: moteslam.run_slam("log"), "recording"),
        (lambda: moteslam.run_slam(EMPTY, seed=1.5), "seed"),
        (lambda: moteslam.run_slam(EMPTY, "paper"), "config"),
        (lambda: moteslam.simulate("corridor"), "scenario"),
        (lambda: moteslam.write_results("x", PATH), "estimate"),
        (lambda: moteslam.score_estimate(PATH, PATH), "estimate"),
        (lambda: moteslam.absolute_trajectory_error("a.tum", PATH), "estimate"),
        (lambda: moteslam.write_tum("x.tum", np.zeros((3, 3))), "trajectory"),
        (lambda: moteslam.resolve_config("paper", "particles=3"), "settings"),
        (lambda: moteslam.findings(moteslam.calibrate(EMPTY), EMPTY), "calibration"),
        (lambda: moteslam.calibrated(EMPTY, None, None), "calibration"),
        (lambda: Trajectory([0.0, 1.0], [[0, 0], [0]]), None),
    ],
)
def test_the_line_names_the_parameter(
    call: Callable[[], Any], parameter: str | None, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.chdir(tmp_path)
    with refusal(MoteslamError, field=parameter):
        call()
    assert not list(tmp_path.iterdir())
