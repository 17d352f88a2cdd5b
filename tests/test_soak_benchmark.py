"""``benchmarks/soak.py``, a sample of it: a minute in a loop."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest
from scripts import ROOT


@pytest.mark.slow
def test_a_sample_of_the_benchmark(tmp_path: Path) -> None:
    out = tmp_path / "soak.json"
    done = subprocess.run(
        [sys.executable, "benchmarks/soak.py", "--hours", "0.02", "--out", str(out)],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    (row,) = json.loads(out.read_text())["rows"]
    assert row["scans"] > 700
    assert 0 < row["trajectory"] < row["resident"]
    assert 0 < row["maps"] < row["resident"]
