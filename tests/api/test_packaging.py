"""What is built and installed agrees with what stands in the folders."""

from __future__ import annotations

import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
FOLDERS = ("kernels", "robot", "sim", "slam", "eval")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PINS = [
    line.strip()
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    if line.strip() and not line.startswith("#")
]


def test_every_package_folder_is_built():
    found = {"moteslam"}
    for folder in FOLDERS:
        for file in (ROOT / folder).rglob("__init__.py"):
            found.add(".".join(("moteslam", *file.parent.relative_to(ROOT).parts)))
    assert sorted(PROJECT["tool"]["setuptools"]["packages"]) == sorted(found)


@pytest.mark.parametrize("package", ["sim.scenarios", "slam.presets", "robot.platforms", "eval.sweep.specs"])
def test_the_bundled_files_are_built(package: str):
    patterns = PROJECT["tool"]["setuptools"]["package-data"][f"moteslam.{package}"]
    folder = ROOT.joinpath(*package.split("."))
    built = {file for pattern in patterns for file in folder.glob(pattern)}
    others = {file for file in folder.iterdir() if file.is_file() and file.suffix != ".py"}
    assert built == others


def test_every_requirement_is_pinned_within_its_bounds():
    pinned = {canonicalize_name(name): version for name, version in (pin.split("==") for pin in PINS)}
    extras = PROJECT["project"]["optional-dependencies"].values()
    for text in (*PROJECT["project"]["dependencies"], *(line for extra in extras for line in extra)):
        requirement = Requirement(text)
        assert pinned[canonicalize_name(requirement.name)] in requirement.specifier, text
