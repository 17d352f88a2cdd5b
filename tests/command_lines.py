"""Command lines that end well, and those that must be refused."""

import json
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from moteslam.eval.cli import main

Capsys = pytest.CaptureFixture[str]


def printed(capsys: Capsys, *arguments: object) -> str:
    """Run a command line that must end well, and return what it printed on stdout since the last one."""
    capsys.readouterr()
    assert main.run([str(argument) for argument in arguments]) == 0
    return capsys.readouterr().out


def shown(capsys: Capsys, *arguments: object) -> Any:
    """What a command line that must end well prints with ``--json``."""
    return json.loads(printed(capsys, *arguments, "--json"))


def codes(capsys: Capsys, *arguments: object) -> list[str]:
    found = shown(capsys, *arguments)
    return [issue["code"] for issue in found.get("warnings", found.get("problems"))]


def told(capsys: Capsys, *arguments: object) -> str:
    """What a command line that must end well says on stderr."""
    capsys.readouterr()
    assert main.run([str(argument) for argument in arguments]) == 0
    return capsys.readouterr().err


def refused(capsys: Capsys, *arguments: object, code: int = 2) -> str:
    """Run a command line that must be refused, and return its one line on stderr; stdout stays empty."""
    capsys.readouterr()
    assert main.run([str(argument) for argument in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("moteslam: ")
    assert err.count("\n") == 1
    return err


def program(*arguments: object, cwd: Path, **environment: str) -> subprocess.CompletedProcess[str]:
    """Run ``moteslam`` in a process of its own."""
    return subprocess.run(
        [sys.executable, "-m", "moteslam", *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, "COLUMNS": "100", **environment},
        capture_output=True,
        text=True,
        timeout=600,
        check=False,
    )
