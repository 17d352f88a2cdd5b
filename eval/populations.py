"""Configurations with their runs, matched by what was run: the files of sweeps, or result folders."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from moteslam.errors import InputError
from moteslam.eval.sweep.store import opened
from moteslam.eval.sweep.tables import group_of
from moteslam.robot.files import read_text

Key = tuple[Any, ...]
"""Scenario or recording, platform, noise, duration, seed: runs of two configurations with the same are a pair."""

MAX_BYTES = 50_000_000
"""No ``metrics.json`` is larger."""


@dataclass(frozen=True)
class Population:
    """The runs of one configuration.

    Attributes:
        name: of the configuration.
        runs: values by metric of each run; None of one that failed.
    """

    name: str
    runs: dict[Key, dict[str, float] | None]

    def values(self, metric: str) -> dict[Key, float | None]:
        """One metric's, None of runs that failed; runs of which it is absent are left out."""
        return {
            key: None if values is None else values[metric]
            for key, values in self.runs.items()
            if values is None or metric in values
        }


def populations(paths: Sequence[Path]) -> list[Population]:
    """The configurations of sweeps, and of result folders, in their order.

    A file of a sweep has one for each of its configurations, with each combination of what varies; of several files the
    name of each stands before them, its path where two are named alike. Result folders have the configuration that they
    hold, named by the folder.

    Raises:
        InputError: a path that is neither, or is damaged.
    """
    found: list[Population] = []
    alike = len({path.stem for path in paths}) < len(paths)
    for path in paths:
        if path.is_dir():
            found.append(_of_folder(path))
        else:
            prefix = f"{path if alike else path.stem}: " if len(paths) > 1 else ""
            found += [Population(f"{prefix}{each.name}", each.runs) for each in _of_sweep(path)]
    return found


def _of_sweep(path: Path) -> list[Population]:
    groups: dict[str, dict[Key, dict[str, float] | None]] = {}
    with opened(path) as store:
        for row in store.rows():
            if not row.status:
                continue
            run = row.run
            key = (dict(group_of(row))["scenario"], run.platform, run.noise, run.duration, run.seed)
            values = {name: value for name, value in (row.values | row.costs).items() if value is not None}
            groups.setdefault(run.configured, {})[key] = values if row.status == "ok" else None
    return [Population(name, runs) for name, runs in groups.items()]


def _of_folder(folder: Path) -> Population:
    metrics, run = (read_table(folder / name) for name in ("metrics.json", "run.json"))
    found = metrics.get("metrics")
    if not isinstance(found, dict):
        raise InputError("missing, expected in every result folder", file=folder / "metrics.json", field="metrics")
    values = {
        str(name): float(value["value"])
        for name, value in found.items()
        if isinstance(value, dict) and isinstance(value.get("value"), int | float)
    }
    return Population(str(folder), {(run.get("recording"), run.get("seed")): values})


def read_table(file: Path) -> dict[str, Any]:
    """A JSON file of a result folder.

    Raises:
        InputError: it is missing, too large, not JSON, or no table.
    """
    try:
        table = json.loads(read_text(file, "a file of a result folder", limit=MAX_BYTES))
    except (ValueError, RecursionError) as error:
        raise InputError(f"not JSON: {error}", file=file) from error
    if not isinstance(table, dict):
        raise InputError("not a table, expected what `moteslam replay` writes", file=file)
    return table
