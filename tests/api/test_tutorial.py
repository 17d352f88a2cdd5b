"""The code of the guide to the library runs, block after block."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

GUIDE = (Path(__file__).parents[2] / "docs" / "guide" / "python.md").read_text(encoding="utf-8")
BLOCKS = re.findall(r"^```python\n(.*?)^```", GUIDE, re.M | re.S)


@pytest.mark.slow
def test_the_blocks_of_the_guide_run(tmp_path: Path) -> None:
    assert len(BLOCKS) > 7
    run = subprocess.run(
        [sys.executable, "-c", "\n".join(BLOCKS)], check=False, capture_output=True, text=True, cwd=tmp_path
    )
    assert run.returncode == 0, run.stderr
    first, *_, last = run.stdout.splitlines()
    found = re.fullmatch(r"([0-9.]+) cm over [0-9]+ m", first)
    assert found is not None, run.stdout
    assert float(found.group(1)) < 5
    assert last.startswith("no such.log - No such file")
