"""The report as one HTML file: what it is made of, tables, charts and a player of runs."""

import base64
import gzip
import hashlib
import json
import os
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from importlib.metadata import distribution
from importlib.resources import files
from pathlib import Path
from typing import Any

import tomli_w
from jinja2 import Environment, StrictUndefined
from jinja2.utils import htmlsafe_json_dumps
from markupsafe import Markup, escape

from moteslam.errors import InputError
from moteslam.eval import runs
from moteslam.eval.metrics.registry import title_of
from moteslam.eval.page import charts
from moteslam.eval.page.player import playable
from moteslam.eval.statistics import FEWEST
from moteslam.eval.sweep.spec import SUCCESS, flat
from moteslam.eval.sweep.store import Row, opened
from moteslam.eval.tables import literal, shortened
from moteslam.files import read_text
from moteslam.robot.values import interval, read_toml

DEPTH, CONFIG = 3, "config.toml"  # Of folders in which result folders are looked for, and a file that each has


@dataclass
class Material:
    """All that a report is made of.

    Attributes:
        runs: in their order, those that were made.
        documents: title and text of what was run: specifications of sweeps, configurations.
        facts: title, and names with values: versions, hardware.
        pending, wanted: runs of sweeps that were not made yet, and metrics that the specifications name.
        success: of these, the limits of a run that succeeds; empty for the usual ones.
    """

    runs: list[Row] = field(default_factory=list)
    documents: list[tuple[str, str]] = field(default_factory=list)
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    pending: int = 0
    wanted: list[str] = field(default_factory=list)
    success: dict[str, float] = field(default_factory=dict)


def gather(paths: Sequence[Path]) -> Material:
    """Read files of sweeps, result folders, and folders that hold any of these."""
    found: list[Path] = []
    for path in paths:
        within = list(_within(path)) if path.is_dir() else [path]
        if not within:
            raise InputError("no result folder and no .sweep file in it, expected some", file=path)
        found += within
    material = Material()
    folders = [path for path in found if path.is_dir()]
    for path in (path for path in found if path not in folders):
        with opened(path) as store:
            spec = json.loads(store.spec)
            material.success |= store.success
            material.wanted += [name for name in spec.get("metrics") or () if name not in material.wanted]
            material.documents.append((f"Specification of {path.name}", tomli_w.dumps(spec)))
            for title, facts in store.environment.items():
                material.facts.setdefault(f"{title} of {path.name}", dict(facts))
            prefix = runs.prefix_of(path, found)
            made = [row.renamed(prefix + row.run.configuration) for row in store.rows() if row.status]
            material.pending += len(store.pending())
        material.runs += made
        if programs := {row.run.configuration: row.run.version for row in made if row.run.version}:
            material.facts[f"programs of {path.name}"] = programs
    # those of one configuration, by the text of ``config.toml``, are runs of it
    texts = runs.grouped(folders, lambda at: read_text(at / CONFIG, "a file of a result folder", limit=runs.MAX_BYTES))
    names = _names(texts)
    for text, members in texts.items():
        material.documents.append((f"Configuration {names[text]}", text))
        for row in map(runs.read_result_folder, members):
            material.runs.append(row.renamed(names[text]))
            for title, values in row.facts.items():
                material.facts.setdefault(title.capitalize(), dict(values))
    if not material.runs:
        raise InputError("no run was made yet, expected at least one", file=paths[0])
    return material


def _within(top: Path) -> Iterator[Path]:
    """Result folders, and files of sweeps, in a folder and those in it."""

    def refuse(error: OSError) -> None:
        raise InputError(f"cannot be read: {error.strerror or error}", file=error.filename or top) from error

    for root, folders, names in os.walk(top, onerror=refuse):
        is_result = {"metrics.json", "run.json"} <= set(names)
        deeper = len(Path(root).relative_to(top).parts) < DEPTH and not is_result
        folders[:] = sorted(name for name in folders if deeper and not name.startswith("."))
        sweeps = [Path(root, name) for name in sorted(names) if name.endswith(".sweep")]
        yield from [Path(root)] if is_result else sweeps


def _names(texts: dict[str, list[Path]]) -> dict[str, str]:
    """A name for each configuration: what it sets otherwise than the first one, else the folder of its runs."""
    tables = {text: flat(read_toml(folders[0] / CONFIG, "a config.toml")) for text, folders in texts.items()}
    keys = dict.fromkeys(key for table in tables.values() for key in table)
    changed = [key for key in keys if len({repr(table.get(key)) for table in tables.values()}) > 1]
    names: dict[str, str] = {}
    for text, folders in texts.items():
        together = len(folders) > 1 and len({folder.parent for folder in folders}) == 1
        name = folders[0].parent.name if together else folders[0].name
        if 0 < len(changed) <= 3:
            name = ", ".join(f"{key}={tables[text].get(key, '-')}" for key in changed)
        same = sum(name == other or other.startswith(f"{name} (") for other in names.values())
        names[text] = f"{name} ({same + 1})" if same else name
    return names


USUAL = (
    *("final.ate", "online.ate", "dead_reckoning.ate", "final.rpe_1m", "map_f1", "map_cells_per_metre"),
    *("nees", "lost_recall", "loops_false", "relations", "cpu_per_scan"),
)
"""Metrics of a report whose sweeps name none."""
MOST_METRICS = 8  # Of a report that was not asked for more
STYLE_OF_MAPS = re.compile(r'getElementById\("([0-9a-f]{32,})"\)')
"""plotly.js adds a style of its geographic maps, which the policy forbids, unless an element of this name is there."""


def page(
    material: Material,
    *,
    title: str | None = None,
    metrics: Sequence[str] = (),
    by: str | None = None,
    baseline: str | None = None,
    progress: Callable[[float], None] = lambda _read: None,
) -> str:
    """The report, as HTML.

    Without metrics it has those that the specifications name, else the usual ones; without an axis and a baseline the
    others are compared as of ``axis_of`` with the first; the title says so. ``progress`` is called with how many runs
    were read. ``ConfigError``: an unknown metric, axis or baseline.
    """
    made, names = material.runs, _metrics(material, metrics)
    axis = runs.axis_of(made, by, baseline)
    columns = runs.compared(made, axis, baseline)
    first = baseline or next(iter(columns))
    shown = runs.headings(made, names)
    keys = runs.apart(made)
    played = [(run, run.folder) for run in made if run.folder is not None]
    players: list[tuple[str, Markup]] = []
    for run, folder in played:
        name = f"{runs.name_of(run, keys or runs.SETTINGS)}, seed {run.run.seed}"
        players.append((name, data_block(playable(folder, len(played)))))
        progress(len(players))

    def grouped(some: Sequence[str]) -> dict[str, list[Row]]:
        return runs.grouped(made, lambda run: runs.name_of(run, some) or run.run.configured())

    several = {key: len({runs.name_of(run, [key]) for run in made}) for key in keys}
    varied = list(dict.fromkeys(key for run in made for key, _ in run.run.varied))
    drawn = [
        {
            "spread": charts.spread(grouped(runs.apart(made, "scenario")), one),
            "curves": [curve for key in varied if (curve := charts.curves(made, key, one)) is not None],
        }
        for one in shown.values()
    ]
    over, each = [runs.key_words(axis)], list(columns)
    if axis == runs.CONFIGURATION:  # with what varies
        over = [runs.key_words(key) for key in varied] or over
        each = list(dict.fromkeys(run.run.configuration for run in made))
    asked = made[0].name if len(made) == 1 else f"{title_of(names[0])} of {len(made)} runs"
    if len(columns) > 1:
        asked = f"{title_of(names[0])} by {', '.join(over)}: {', '.join(each)}"
    pairs = {name: runs.comparisons(made, name, axis, first) for name in names}
    return _render(
        {
            "title": shortened(asked, 160) if title is None else title,
            "made": datetime.now(UTC).strftime("%Y-%m-%d %H:%M UTC"),
            "material": material,
            "issues": runs.warnings_of(made),
            "names": names,
            "shown": shown,
            "meanings": {name: runs.known_metric(name).meaning for name in names},
            "runs": made,
            "axis": runs.key_words(axis),
            "groups": grouped(keys),  # each scenario has a row: several have no common median
            "group": " and ".join(keys) or axis,
            "about": [key for key in runs.SETTINGS if any(run.about[key] for run in made)],
            "several": {**several, "seed": len({run.run.seed for run in made})},
            "baseline": first,
            "also": runs.also_of(columns, axis),
            "pairs": pairs if any(each for some in pairs.values() for each in some.values()) else {},
            "fewest": FEWEST,
            "limits": runs.success_words(material.success or SUCCESS),
            "failures": [run for run in made if run.status != "ok"],
            "players": players,
            "charts": data_block(drawn),
            "has_curves": any(each["curves"] for each in drawn),
        }
    )


def data_block(value: Any) -> Markup:
    """JSON that cannot end the script element that it stands in, nor begin a comment."""
    return htmlsafe_json_dumps(value, separators=(",", ":"), allow_nan=False)


def _render(context: dict[str, Any]) -> str:
    assets = files("moteslam.eval.page")
    names = "page.css", "player.js", "page.js"
    style, *scripts = (assets.joinpath(name).read_text(encoding="utf-8") for name in names)
    library = distribution("plotly").locate_file("plotly/package_data/plotly.min.js")  # the package is not imported
    plotly = Path(str(library)).read_text(encoding="utf-8")
    environment = Environment(
        autoescape=True,
        undefined=StrictUndefined,
        finalize=lambda value: value if isinstance(value, Markup) or not isinstance(value, str) else literal(value),
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters |= {
        "interval": interval,
        "share": lambda one: "-" if one is None else f"{one.count} of {one.total}{one.range}",
        "lines": lambda text: Markup("\n").join(escape(literal(line)) for line in text.splitlines()),
        "key": lambda value: "" if value is None else repr(value),  # by which a cell is sorted
        "success": runs.success_of,
        "summary": runs.summary_of,
        "s": lambda count: "" if count == 1 else "s",
    }
    allowed = " ".join(map(_hash, (plotly, *scripts)))
    policy = (
        f"default-src 'none'; script-src {allowed}; style-src {_hash(style)} {_hash('')}; "
        "img-src data: blob:; base-uri 'none'; form-action 'none'"
    )
    context |= {
        "no_styles": STYLE_OF_MAPS.findall(plotly),
        "library": Markup(base64.b64encode(gzip.compress(plotly.encode(), mtime=0)).decode()),
        "policy": Markup(policy),
        "style": Markup(style),
        "scripts": list(map(Markup, scripts)),
    }
    return environment.from_string(assets.joinpath("page.html").read_text(encoding="utf-8")).render(**context)


def _hash(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def _metrics(material: Material, wanted: Sequence[str]) -> list[str]:
    having = list(dict.fromkeys(name for run in material.runs for name in run.known))
    if wanted:
        return runs.metric_names(list(wanted), material.runs)
    found = [name for name in (*material.wanted, *USUAL) if name in having] or having or material.wanted
    found = list(dict.fromkeys(found or ["final.ate"]))[: max(MOST_METRICS, len(set(material.wanted)))]
    each = runs.compared(material.runs).values()
    # first one that all configurations have: an external command has no online path
    full = (name for name in found if all(any(name in run.known for run in some) for some in each))
    return sorted(found, key=next(full, found[0]).__ne__)
