"""The package's root: every public name is there, and importing it costs nothing."""

from __future__ import annotations

import json
import subprocess
import sys
from importlib.metadata import version

import pytest

import moteslam

HEAVY = ("taichi", "numpy", "scipy", "matplotlib", "pymunk", "shapely", "cv2", "pydantic", "typer", "rich")


def modules_after(code: str) -> set[str]:
    """The names of the modules that a new interpreter has loaded after some code."""
    script = f"{code}\nimport json, sys\nprint(json.dumps(sorted(sys.modules)))"
    run = subprocess.run([sys.executable, "-c", script], check=True, capture_output=True, text=True)
    return set(json.loads(run.stdout.splitlines()[-1]))


def test_importing_the_package_imports_nothing_heavy():
    loaded = modules_after("import moteslam")
    assert "moteslam" in loaded
    assert not loaded.intersection(HEAVY)


def test_an_error_can_be_caught_without_anything_heavy():
    assert not modules_after("from moteslam import MoteslamError, InputError").intersection(HEAVY)


@pytest.mark.parametrize("name", [name for name in moteslam.__all__ if not name.startswith("__")])
def test_every_public_name_is_there_and_says_what_it_is(name: str):
    assert (getattr(moteslam, name).__doc__ or "").strip()


def test_the_public_names_are_listed_before_they_are_loaded():
    listed = subprocess.run(
        [sys.executable, "-c", "import moteslam; print(*dir(moteslam))"], check=True, capture_output=True, text=True
    ).stdout.split()
    assert set(moteslam.__all__) <= set(listed)


def test_an_unknown_name_is_an_attribute_error_that_names_it():
    with pytest.raises(AttributeError, match="no attribute 'slamm'"):
        moteslam.slamm  # noqa: B018


def test_the_version_is_that_of_the_installed_package():
    assert moteslam.__version__ == version("moteslam")
