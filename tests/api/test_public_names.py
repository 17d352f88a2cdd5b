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


def test_importing_the_package_and_its_errors_imports_nothing_heavy_and_lists_the_names():
    names = "assert set(moteslam.__all__) <= set(dir(moteslam))"
    loaded = modules_after(f"import moteslam\nfrom moteslam import MoteslamError, InputError\n{names}")
    assert "moteslam" in loaded
    assert not loaded.intersection(HEAVY)


def test_every_public_name_is_there_and_says_what_it_is():
    for name in moteslam.__all__:
        assert name.startswith("__") or (getattr(moteslam, name).__doc__ or "").strip(), name


def test_an_unknown_name_is_an_attribute_error_that_names_it():
    with pytest.raises(AttributeError, match="no attribute 'slamm'"):
        moteslam.slamm  # noqa: B018


def test_the_version_is_that_of_the_installed_package():
    assert moteslam.__version__ == version("moteslam")
