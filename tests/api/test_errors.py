"""Errors: one line that names the file, the field and what was expected."""

from __future__ import annotations

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
        (
            ConfigError("0, expected 1 or more", file="c.toml", field="particles"),
            "c.toml: particles: 0, expected 1 or more",
        ),
        (OutputError("the disk is full", file="out"), "out: the disk is full"),
    ],
)
def test_an_error_is_one_line_of_file_field_and_problem(error: MoteslamError, line: str):
    assert str(error) == line


def test_the_parts_of_an_error_can_be_asked_for():
    error = InputError("no ranges", file=Path("Hokuyo20.npz"), field="ranges", line=7)
    assert (error.problem, error.file, error.field, error.line) == ("no ranges", "Hokuyo20.npz", "ranges", 7)


@pytest.mark.parametrize("kind", [InputError, ConfigError, OutputError, BackendError])
def test_every_error_is_caught_as_the_one_base(kind: type[MoteslamError]):
    with pytest.raises(MoteslamError):
        raise kind("something")


def test_line_breaks_in_names_are_escapes():
    error = InputError("topic 'a\nb\u2028c', expected a name", file="x\ry.bag")
    assert str(error) == "x\\ny.bag: topic 'a\\nb\\nc', expected a name"
