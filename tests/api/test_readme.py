"""What the README and the guide to the library ask a newcomer to do works."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from moteslam.eval.cli import main

ROOT = Path(__file__).parents[2]
README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "guide" / "python.md").read_text(encoding="utf-8")
COMMANDS = re.findall(r"^\| `moteslam ([a-z]+)([^`]*)`", README, re.M)


def run_beside_python(program: str, *arguments: str) -> subprocess.CompletedProcess[str]:
    """Run a program of this environment, its output captured."""
    path = Path(sys.executable).parent / program
    return subprocess.run([path, *arguments], check=False, capture_output=True, text=True)


@pytest.mark.parametrize(("command", "usage"), COMMANDS, ids=[name for name, _ in COMMANDS])
def test_every_command_of_the_table_exists_with_its_options(
    command: str, usage: str, capsys: pytest.CaptureFixture[str]
):
    assert main.run([command, "--help"]) == 0
    said = capsys.readouterr().out
    for word in usage.split():
        if word.startswith("--") or word.isupper():
            assert word in said or word == "DIR"


def test_the_table_has_all_commands(capsys: pytest.CaptureFixture[str]):
    assert main.run(["--help"]) == 0
    listed = re.findall(r"^  ([a-z]+) ", capsys.readouterr().out.partition("Commands:")[2], re.M)
    assert sorted(listed) == sorted(name for name, _ in COMMANDS)


@pytest.mark.slow
def test_the_example_finds_its_way():
    example = re.search(r"```python\n(.*?)```", README, re.S)
    assert example is not None
    run = run_beside_python(Path(sys.executable).name, "-c", example.group(1))
    assert run.returncode == 0, run.stderr
    found = re.fullmatch(r"off by ([0-9.]+) cm over ([0-9]+) m\n", run.stdout)
    assert found is not None, run.stdout
    assert float(found.group(1)) < 20
    assert int(found.group(2)) >= 80


@pytest.mark.slow
def test_the_blocks_of_the_guide_run_one_after_the_other(tmp_path: Path):
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE, re.M | re.S)
    assert len(blocks) > 7
    command = [sys.executable, "-c", "\n".join(blocks)]
    run = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    first, *_, last = run.stdout.splitlines()
    found = re.fullmatch(r"([0-9.]+) cm over [0-9]+ m", first)
    assert found is not None, run.stdout
    assert float(found.group(1)) < 5
    assert last.startswith("no such.log - No such file")
