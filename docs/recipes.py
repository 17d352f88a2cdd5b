"""Writes tables and pictures of docs/guide/recipes.md and corridor-suite-1.md from the files of sweeps.

    moteslam sweep particles --out results/particles.sweep
    .venv/bin/python docs/recipes.py results

Of each recipe whose file is in the folder, the picture is drawn and the table is put between the comments of its name.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from math import isfinite
from pathlib import Path

from moteslam.eval.report.sweep_curves import Places, draw_sweep, lines_of
from moteslam.eval.statistics.summary import Summary
from moteslam.eval.sweep.store import Row, opened
from moteslam.eval.sweep.tables import better, summaries
from moteslam.eval.tables import markdown

DOCS = Path(__file__).parent
ATE, DEAD_RECKONING, F1 = "final.ate", "dead_reckoning.ate", "map_f1"
SUITE, MRPT = "corridor-suite-1", "mrpt-corridor-suite-1"


@dataclass(frozen=True)
class Recipe:
    """What is drawn and tabulated of a recipe.

    Attributes:
        column: what it is drawn over.
        label: of that axis.
        metrics: a panel each.
    """

    column: str
    label: str
    metrics: tuple[str, ...] = (ATE, F1)


RECIPES = {
    "particles": Recipe("slam.particles", "particles"),
    "lidar-beams": Recipe("configuration", "beams in a turn"),
    "lidar-range": Recipe("platform.lidar.range_max", "longest range [m]"),
    "range-noise": Recipe("scenario.noise.lidar.range_noise", "standard deviation of a range [m]"),
    "encoder-noise": Recipe("scenario.noise.encoders.slip", "standard deviation of the slip", (ATE, DEAD_RECKONING)),
    "yaw-noise": Recipe(
        "scenario.noise.imu.gyro_noise", "standard deviation of the yaw rate [rad/s]", (ATE, DEAD_RECKONING)
    ),
    "key-scan-spacing": Recipe("slam.backend.distance", "distance between key scans [m]"),
    "people": Recipe("configuration", "people in the building"),
}


def rows_of(file: Path) -> list[Row]:
    """The runs of a sweep that were made."""
    with opened(file) as store:
        return [row for row in store.rows() if row.status]


def recipe_table(recipe: Recipe, rows: Sequence[Row]) -> str:
    """A row a metric and line, a column a value; errors in centimetres."""
    groups = summaries(rows, recipe.metrics, {})
    places = Places.of([group.about[recipe.column] for group in groups])
    lines = lines_of(groups, recipe.column, places)
    table = [["", recipe.label, *(f"{value}" for value in places.values)]]
    for name in recipe.metrics:
        for line in lines:
            found = {group.about[recipe.column]: cell(name, group.values[name]) for group in line.groups}
            table.append([headed(name), line.label, *(found.get(value, "") for value in places.values)])
    return markdown(table, right=range(2, len(table[0])))


def suite_table(rows: Sequence[Row], names: Sequence[str], *, dead_reckoning: bool) -> str:
    """A row a scenario, robot and class of noise: the final error of each configuration [cm], and its map.

    Args:
        rows: of one or more sweeps on the same cases.
        names: of the configurations.
        dead_reckoning: its error stands first.
    """
    head = [*(["dead reckoning [cm]"] if dead_reckoning else []), *(f"{name} [cm]" for name in names)]
    head += [f"map F1, {name}" if name == names[0] else name for name in names]
    table = [["scenario", "robot", "noise", *head]]
    cases = list(dict.fromkeys((row.run.scenario, row.run.platform, row.run.noise) for row in rows))
    for case in [*cases, ("all", "", "")]:
        here = [row for row in rows if case[0] == "all" or (row.run.scenario, row.run.platform, row.run.noise) == case]
        of = {name: [row for row in here if row.run.configuration == name] for name in names}
        columns = [(DEAD_RECKONING, of[names[-1]])] if dead_reckoning else []
        columns += [(metric, of[name]) for metric in (ATE, F1) for name in names]
        table.append([*case, *(cell(name, summed(name, runs)) for name, runs in columns)])
    return markdown(table, right=range(3, len(table[0])))


def summed(name: str, rows: Sequence[Row]) -> Summary:
    """A metric over runs."""
    good = [row for row in rows if row.status == "ok"]
    return Summary.of([row.values.get(name) for row in good], len(rows) - len(good), better=better(name))


def cell(name: str, summary: Summary) -> str:
    """Median and interval, of errors in centimetres."""
    median, low, high = (number(name, value) for value in (summary.median, summary.low, summary.high))
    return f"{median} ({low} to {high})"


def number(name: str, value: float | None) -> str:
    """A value with about three digits, of errors in centimetres."""
    if value is None or not isfinite(value):
        return "-" if value is None else "failed"
    return f"{value:.3f}" if name == F1 else f"{100 * value:.{2 if 100 * value < 10 else 1}f}"


def headed(name: str) -> str:
    """The metric with its unit in the table."""
    return name if name == F1 else f"{name} [cm]"


def put(page: Path, name: str, table: str) -> None:
    """Put a table between the comments of its name."""
    text = page.read_text(encoding="utf-8")
    begin, end = f"<!-- table: {name} -->", "<!-- end -->"
    pattern = re.compile(f"{re.escape(begin)}.*?{re.escape(end)}", re.DOTALL)
    page.write_text(pattern.sub(lambda _: f"{begin}\n{table}\n{end}", text, count=1), encoding="utf-8")


def main() -> None:
    """Write what the files of a folder have."""
    folder = Path(sys.argv[1])
    for name, recipe in RECIPES.items():
        if not (folder / f"{name}.sweep").exists():
            continue
        rows = rows_of(folder / f"{name}.sweep")
        groups = summaries(rows, recipe.metrics, {})
        picture = DOCS / "images" / f"recipe_{name.replace('-', '_')}.png"
        draw_sweep(picture, groups, recipe.metrics, column=recipe.column, label=recipe.label)
        put(DOCS / "guide" / "recipes.md", name, recipe_table(recipe, rows))
        sys.stdout.write(f"{picture}\n")
    if (folder / f"{SUITE}.sweep").exists():
        page, rows = DOCS / "guide" / f"{SUITE}.md", rows_of(folder / f"{SUITE}.sweep")
        put(page, SUITE, suite_table(rows, ("paper", "default"), dead_reckoning=True))
        if (folder / f"{MRPT}.sweep").exists():
            rows += rows_of(folder / f"{MRPT}.sweep")
            put(page, MRPT, suite_table(rows, ("icp", "rbpf", "default"), dead_reckoning=False))


if __name__ == "__main__":
    main()
