"""``benchmarks/speed.py``: kernels, plain C loops and twins do the same work, or it says so."""

from __future__ import annotations

import csv
import shutil
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import speed
from parts.rays import raycasting
from parts.tasks import Loops, Task, grid_update, integration, matching, registration, search, thinning

pytestmark = pytest.mark.usefixtures("taichi")

SMALL: dict[str, Callable[[Loops], Task]] = {
    "thinning": partial(thinning, count=2),
    "registration": partial(registration, count=5),
    "integration": partial(integration, count=5),
    "search": partial(search, count=5),
    "matching": partial(matching, count=5),
    "raycasting": partial(raycasting, count=1),
    "grid": grid_update,
}
OTHER_WORK = {
    "loops.c": {
        ">= within)": ">= 0.9f * within)",
        "cells[j] = y * w + x": "cells[j] = y * w + x + 1",
        "u <= 1.0f": "u <= 0.9f",
        "error = major / 2": "error = major / 3",
    },
    "maps.c": {
        "STEPS = 1023": "STEPS = 1000",
        "overlap = 0.25f": "overlap = 0.3f",
        "-(near / 2)": "-(near / 3)",
    },
}
"""A change for each task."""

needs_compiler = pytest.mark.skipif(not any(map(shutil.which, ("gcc", "clang", "cc"))), reason="no C compiler")


@pytest.fixture(autouse=True)
def environment(monkeypatch: pytest.MonkeyPatch) -> None:
    """What ``main`` sets is set back, and Taichi runs already."""
    monkeypatch.setenv("OMP_NUM_THREADS", "1")
    monkeypatch.setenv("OMP_WAIT_POLICY", "passive")
    monkeypatch.delenv("CC", raising=False)
    monkeypatch.setattr("moteslam.kernels.runtime.init", lambda *_: None)
    monkeypatch.setattr(speed, "TASKS", SMALL)


@needs_compiler
def test_kernels_twins_and_loops_compute_the_same(tmp_path: Path) -> None:
    loops, _ = speed.compile_loops(tmp_path, 1)
    assert (np.full(3, 1e-310) > 0).all()  # a library linked with -ffast-math sets numbers as small to 0
    for name, task in SMALL.items():
        found = speed.measure(task(loops), 1, 1)
        assert "C" in found, name
        assert all(time > 0 for times in found.values() for contender in times for time in contender), name


@needs_compiler
def test_other_work_has_no_figures(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    sources = [Path(shutil.copy(source, tmp_path)) for source in speed.SOURCES]
    for source in sources:
        text = source.read_text()
        for old, new in OTHER_WORK[source.name].items():
            assert old in text
            text = text.replace(old, new)
        source.write_text(text)
    monkeypatch.setattr(speed, "SOURCES", sources)
    assert speed.main(["--rounds", "1"]) == 1
    printed = capsys.readouterr()
    assert [line.split(":")[0] for line in printed.err.splitlines()] == list(SMALL)
    assert printed.err.count("of the kernel and of C differ") == len(SMALL)
    assert "ratio" not in printed.out


@needs_compiler
def test_a_table_of_ratios(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "speed.csv"
    assert speed.main(["--tasks", "search", "--rounds", "3", "--out", str(out)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[1].startswith("C by ")
    assert [line.split()[:3] for line in printed[3:]] == [["search", "particle", "C"], ["search", "particle", "Python"]]
    for row in csv.DictReader(out.read_text().splitlines()):
        ratio, low, high = (float(row[name]) for name in ("ratio", "low", "high"))
        assert 0 < low <= ratio <= high
        assert row["rounds"] == "3"


@needs_compiler
def test_a_compiler_without_openmp_is_for_one_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    real = next(filter(None, map(shutil.which, ("gcc", "clang", "cc"))))
    plain = tmp_path / "plain"
    plain.write_text(
        f'#!/bin/sh\ncase "$*" in *-fopenmp*) echo "what is -fopenmp?" >&2; exit 1;; esac\nexec {real} "$@"\n'
    )
    plain.chmod(0o755)
    monkeypatch.setenv("CC", f"{plain} -Wall")
    loops, how = speed.compile_loops(tmp_path, 1)
    assert loops.library is not None
    assert how == f"C by {plain} -Wall -O3 -ffast-math -fPIC -march=native"
    loops, how = speed.compile_loops(tmp_path, 2)
    assert loops.library is None
    assert how == f"no C loops: {plain} cannot compile them: what is -fopenmp?"


def test_without_a_compiler_the_twins_are_left(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert speed.main(["--tasks", "grid", "thinning", "--rounds", "1"]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert printed[1:3] == [
        "no C loops: there is no gcc, clang or cc",
        "thinning: left out, nothing here does its work",
    ]
    assert [line.split()[:3] for line in printed[4:]] == [["grid", "scan", "Python"]]
    monkeypatch.setenv("CC", "icc -fast")
    assert speed.compile_loops(tmp_path, 1)[1] == "no C loops: there is no icc"
    broken = tmp_path / "broken"
    broken.write_text('#!/bin/sh\necho "no space left" >&2\nexit 4\n')
    broken.chmod(0o755)
    monkeypatch.setenv("CC", str(broken))
    assert speed.compile_loops(tmp_path, 1)[1] == f"no C loops: {broken} cannot compile them: no space left"
