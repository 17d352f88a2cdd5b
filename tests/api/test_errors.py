"""Errors: one line that names the file, the field and what was expected."""

from pathlib import Path

import pytest

from moteslam.errors import BackendError, ConfigError, InputError, MoteslamError, OutputError


@pytest.mark.parametrize(
    ("error", "line"),
    [
        (MoteslamError("no poses"), "no poses"),
        (InputError("no poses", file=Path("run/a.tum")), "run/a.tum: no poses"),
        (InputError("expected 8 numbers", file="a.tum", line=3), "a.tum:3: expected 8 numbers"),
        (InputError("expected 8 numbers", line=3), "line 3: expected 8 numbers"),
        (ConfigError("0, expected 1 or more", field="particles"), "particles: 0, expected 1 or more"),
        (BackendError("no CUDA", file="c.toml", field="arch"), "c.toml: arch: no CUDA"),
        (OutputError("a\nb\u2028c", file="x\ry.bag"), "x\\ny.bag: a\\nb\\nc"),
    ],
)
def test_an_error_is_one_line_of_file_field_and_problem(error: MoteslamError, line: str):
    assert str(error) == line
    assert isinstance(error, MoteslamError)


def test_the_parts_of_an_error_can_be_asked_for():
    error = InputError("no ranges", file=Path("Hokuyo20.npz"), field="ranges", line=7)
    assert (error.problem, error.file, error.field, error.line) == ("no ranges", "Hokuyo20.npz", "ranges", 7)
