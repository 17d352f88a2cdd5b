"""The specifications that come with the package, and what identifies the runs of a specification."""

from __future__ import annotations

import hashlib
import json
import tomllib
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.robot.platforms import BASE, UCSD
from moteslam.robot.platforms import FOLDER as PLATFORMS
from moteslam.robot.tables import read_toml
from moteslam.sim.scenario import SCENARIOS

FOLDER = Path(__file__).parent / "specs"
WORDS = ("description", "why")
"""Keys of scenarios and robots from which no run follows."""


def bundled_specs() -> dict[str, Path]:
    """The files of the specifications that come with the package, by name."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}


def spec_file(name_or_path: str | PathLike[str]) -> Path:
    """The file of a specification: a bundled one by its name, or a path.

    Raises:
        ConfigError: an unknown name; the known ones are listed.
    """
    text, path, bundled = str(name_or_path), Path(name_or_path), bundled_specs()
    if text in bundled:
        return bundled[text]
    if path.suffix == ".toml" or path.is_file():
        return path
    expected = f"one of {', '.join(bundled)}, or a .toml file"
    raise ConfigError(f"no specification of this name, expected {expected}", file=text)


def digest(runs: Iterable[PlannedRun]) -> str:
    """SHA-256 of what runs are, as 64 hexadecimal digits; two sweeps of the same have the same runs.

    Of the identities of the runs, and of the tables of their scenarios and robots, descriptions and comments left out.
    The code is not in it, nor are the presets, random buildings and the contents of recordings.

    Args:
        runs: all of a sweep, in any order.

    Raises:
        ConfigError: the file of a scenario or of a robot cannot be read.
    """
    names: set[str] = set()
    cases: set[tuple[str, str]] = set()
    for run in runs:
        names.add(run.id)
        cases.add((run.scenario, run.platform))
    scenarios = {name: _table(name, SCENARIOS) for name in sorted({scenario for scenario, _ in cases})}
    robots: dict[str, Any] = {}
    for scenario, platform in sorted(cases):
        if scenario:
            own = (scenarios[scenario] or {}).get("platform", UCSD.name)
            _add_robot(robots, platform or own, Path(scenario).parent)
    whole = {"runs": sorted(names), "scenarios": scenarios, "platforms": robots}
    return hashlib.sha256(json.dumps(whole, sort_keys=True, default=str).encode()).hexdigest()


def _add_robot(robots: dict[str, Any], robot: Any, beside: Path) -> None:
    """Add the table of a robot, and of the one that it is based on; one within a scenario is in that already."""
    if isinstance(robot, str):
        name = str(beside / robot) if robot.endswith(".toml") else robot
        if name not in robots:
            robots[name] = _table(name, PLATFORMS)
            _add_robot(robots, robots[name], beside)
    elif isinstance(robot, dict) and BASE in robot:
        _add_robot(robots, robot[BASE], beside)


def _table(name: str, folder: Path) -> dict[str, Any] | None:
    """The table of a bundled name or of a file; None for a random building, which has no file."""
    path = Path(name)
    if path.suffix != ".toml" and path.name == name:
        path = folder / f"{name}.toml"
        if not path.is_file():
            return None
        table = tomllib.loads(path.read_text(encoding="utf-8"))
    else:
        table = read_toml(path, "a .toml file")
    return {key: value for key, value in table.items() if key not in WORDS}
