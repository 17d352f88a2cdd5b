"""Issues: the same in text, in JSON and in Python, and every code in the documentation."""

from __future__ import annotations

import json
import re
from pathlib import Path

import numpy as np
import pytest
from robot_logs import flaser, write_log

from moteslam.eval.cli.main import run
from moteslam.robot.formats import open_recording

ROOT = Path(__file__).parents[2]


def test_text_json_and_python_have_the_same_issues(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    ranges = np.full(181, 3.0)
    lines = [flaser([-1.0, *(ranges[1:] + k / 100)], stamp=k / 5, robot=(k / 20, 0.0, 0.0)) for k in range(8)]
    log = write_log(tmp_path / "a.log", [*lines, "FLASER 181 1.0", "FLASER x"])
    assert run(["replay", str(log), "--out", str(tmp_path / "out"), "--no-figures", "--json"]) == 0
    out, err = capsys.readouterr()
    issues = json.loads(out)["warnings"]
    assert [(issue["code"], issue["count"]) for issue in issues] == [("broken-lines", 2), ("invalid-ranges", 8)]
    assert [line for line in err.splitlines() if "warning" in line] == [
        f"moteslam: warning: {issue['message']}" for issue in issues
    ]
    assert json.loads((tmp_path / "out" / "run.json").read_text())["warnings"] == issues
    recording = open_recording(log)
    assert [issue.as_dict() for issue in recording.warnings] == issues
    assert run(["inspect", str(log), "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["problems"][:2] == issues


def test_every_code_is_documented() -> None:
    sources = [path for folder in ("robot", "slam", "eval", "sim") for path in (ROOT / folder).rglob("*.py")]
    text = "\n".join(path.read_text("utf-8") for path in sources)
    given = set(re.findall(r'(?:Issue|tell|told\.append\()\(\s*"([a-z-]+)"', text))
    page = (ROOT / "docs" / "reference" / "formats.md").read_text("utf-8")
    table = page.partition("## Warnings")[2].partition("## Bounds")[0]
    documented = set(
        re.findall(r"`([a-z-]+)`", "\n".join(line.split("|")[1] for line in table.splitlines() if "| " in line))
    ) - {"code"}
    assert given <= documented
    assert {code for code in documented if f'"{code}"' not in text} == set()
