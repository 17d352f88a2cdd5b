"""The scripts in ``benchmarks/``: a sample of one, and that kernels, plain C loops and twins do the same work."""

import csv
import shutil
import subprocess
import sys
from inspect import signature
from pathlib import Path

import pytest
import speed

ROOT = Path(__file__).parents[1]


@pytest.mark.slow
def test_a_sample_of_the_accuracies_is_measured(tmp_path: Path):
    out = tmp_path / "rows.csv"
    sample = ("scenarios", "--runs", "corridor", "--seeds", "0-0", "--out", str(out))
    command = [sys.executable, "benchmarks/accuracy.py", *sample]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    rows = list(csv.DictReader(out.read_text().splitlines()))
    assert rows
    assert not any(row.get("error") for row in rows)


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.skipif(not any(map(shutil.which, speed.COMPILERS)), reason="no C compiler")
def test_kernels_twins_and_loops_compute_the_same(tmp_path: Path):
    loops, how = speed.compile_loops(tmp_path, 1)
    assert how.startswith("C by")
    for name, task in speed.TASKS.items():
        few = {"count": 5} if "count" in signature(task).parameters else {}
        found = speed.measure(task(loops, **few), 1, 1)
        assert "C" in found, name
        assert all(time > 0 for times in found.values() for contender in times for time in contender), name
