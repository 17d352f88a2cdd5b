"""Configurations with their runs, matched by what was run: from the files of sweeps, or from result folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from moteslam.eval.results import read_result_folder
from moteslam.eval.sweep.store import opened
from moteslam.eval.sweep.tables import group_of

Runs = dict[tuple[Any, ...], dict[str, float] | None]
"""Values by metric of each run of a configuration, None of one that failed; runs of two configurations with the same
key (scenario or recording, platform, noise, duration, seed) are a pair."""


def populations(paths: Sequence[Path]) -> dict[str, Runs]:
    """The configurations of sweeps, and of result folders, by name in their order.

    A file of a sweep has one for each of its configurations, with each combination of what varies; of several files the
    name of each stands before them, its path where two are named alike. A result folder has one, named by the folder.
    """
    found: dict[str, Runs] = {}
    alike = len({path.stem for path in paths}) < len(paths)
    for path in paths:
        if path.is_dir():
            result = read_result_folder(path)
            found[str(path)] = {(result.run.get("recording"), result.run.get("seed")): result.values}
            continue
        prefix = f"{path if alike else path.stem}: " if len(paths) > 1 else ""
        with opened(path) as store:
            for row in store.rows():
                if row.status:
                    run = row.run
                    key = (group_of(row)["scenario"], run.platform, run.noise, run.duration, run.seed)
                    found.setdefault(prefix + run.configured, {})[key] = row.known if row.status == "ok" else None
    return found


def values_of(runs: Runs, metric: str) -> dict[tuple[Any, ...], float | None]:
    """One metric's, None of runs that failed; runs of which it is absent are left out."""
    return {
        key: None if values is None else values[metric]
        for key, values in runs.items()
        if values is None or metric in values
    }
