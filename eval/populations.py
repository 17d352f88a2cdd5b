"""Configurations with their runs, matched by what was run: from the files of sweeps, or from result folders."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from moteslam.eval.results import read_result_folder
from moteslam.eval.statistics import Population
from moteslam.eval.sweep.store import opened
from moteslam.eval.sweep.tables import group_of


def populations(paths: Sequence[Path]) -> list[Population]:
    """The configurations of sweeps, and of result folders, in their order.

    A file of a sweep has one for each of its configurations, with each combination of what varies; of several files the
    name of each stands before them, its path where two are named alike. A result folder has one, named by the folder.

    Raises:
        InputError: a path that is neither, or is damaged.
    """
    found: list[Population] = []
    alike = len({path.stem for path in paths}) < len(paths)
    for path in paths:
        if path.is_dir():
            result = read_result_folder(path)
            found.append(Population(str(path), {(result.run.get("recording"), result.run.get("seed")): result.values}))
        else:
            prefix = f"{path if alike else path.stem}: " if len(paths) > 1 else ""
            found += [Population(prefix + each.name, each.runs) for each in _of_sweep(path)]
    return found


def _of_sweep(path: Path) -> list[Population]:
    found: dict[str, Population] = {}
    with opened(path) as store:
        for row in store.rows():
            if not row.status:
                continue
            run = row.run
            key = (dict(group_of(row))["scenario"], run.platform, run.noise, run.duration, run.seed)
            runs = found.setdefault(run.configured, Population(run.configured, {})).runs
            runs[key] = row.known if row.status == "ok" else None
    return list(found.values())
