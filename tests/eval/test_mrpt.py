"""The example that runs MRPT's SLAM, and the configurations of the guide: they can be read."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from moteslam.eval.sweep.plan import plan
from moteslam.eval.sweep.spec import read_spec

EXAMPLES = Path(__file__).parents[2] / "docs" / "examples"
SCRIPT = EXAMPLES / "mrpt_slam.py"


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
