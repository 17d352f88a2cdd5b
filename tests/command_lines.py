"""Command lines that must be refused."""

from __future__ import annotations

import pytest

from moteslam.eval.cli import main


def refused(capsys: pytest.CaptureFixture[str], *arguments: object, code: int = 2) -> str:
    """Run a command line that must be refused, and return its one line on stderr; stdout stays empty."""
    assert main.run([str(argument) for argument in arguments]) == code
    out, err = capsys.readouterr()
    assert out == ""
    assert err.startswith("moteslam: ")
    assert err.count("\n") == 1
    return err
