"""``moteslam compare`` and ``report``: configurations in pairs, as tables and as a page; what ``sweep show`` prints."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from moteslam.errors import InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.options import arg, opt
from moteslam.eval.cli.text import answer, note, progress_bar
from moteslam.eval.tables import BETWEEN, FORMATS, Rows, aligned, literal, number

if TYPE_CHECKING:
    from moteslam.eval.runs import Shown
    from moteslam.eval.sweep.store import Store

COUNTS = ("pairs", "wins", "losses", "ties")
HEAD = ("equal", "median difference", "95 %", "p", "failed", "failed, first")


def compare(
    paths: Annotated[list[Path], arg("Files of sweeps, or result folders; the first is the baseline.", "PATH...")],
    metrics: options.Metrics = None,
    by: options.By = None,
    baseline: options.Baseline = None,
    form: options.Format = "text",
    as_json: options.Json = False,
) -> None:
    """Compare configurations or robots on the same seeds.

    Each is compared with the first: how often it is better, the median difference with its 95 % interval, and how
    probable so uneven wins would be between equals (sign test). A failed run loses against any other. Each scenario has
    a row, because differences in a corridor and in a hall have no common median.

    \b
    Examples:
      moteslam compare particles.sweep
      moteslam compare lidars.sweep --by platform --baseline ucsd
      moteslam compare before.sweep after.sweep --metric final.ate --metric cpu_per_scan
    """  # noqa: D301
    from moteslam.eval import runs
    from moteslam.eval.sweep.plan import ALONE

    runs.metric_names(metrics)  # before files are read
    rows = [row for row in runs.read_runs(paths) if row.status]
    names = runs.metric_names(metrics, rows)
    axis = runs.axis_of(rows, by, baseline)
    found = runs.compared(rows, axis, baseline)
    if len(found) < 2:
        raise InputError(f"{len(found)} {axis}, expected two or more to compare", file=paths[0])
    first = baseline or next(iter(found))
    for other in (other for other in found if other != first and axis in (runs.CONFIGURATION, ALONE)):
        both = (*found[first], *found[other])
        if len({row.about["platform"] for row in both}) > 1 or any(row.run.command for row in both):
            continue  # of other lidars; or poses of another program, which need not be one a scan
        of, counts = (runs.values_of(found[one], "scans", axis) for one in (first, other))
        if unlike := [case for case in of if of[case] and (counts.get(case) or of[case]) != of[case]]:
            text = f"warning: {other}: other numbers of scans in {len(unlike)} of its runs"
            note(f"{text}: another recording of that name, whose errors cannot be compared?")
    compared = {
        name: {other: {place: asdict(one) for place, one in each.items()} for other, each in pairs.items()}
        for name in names
        for pairs in [runs.comparisons(rows, name, axis, first)]
        if metrics or any(pairs.values())
    }
    if not any(each for pairs in compared.values() for each in pairs.values()):
        other = next(each for each in found if each != first)
        problem = f"no run in common with {first} that has {', '.join(names)}"
        for key in (*runs.SETTINGS, "seed"):
            one, two = ({str(row.about.get(key, row.run.seed)) for row in found[each]} for each in (first, other))
            if one.isdisjoint(two):
                problem += f"; {key} {', '.join(sorted(one))} there, {', '.join(sorted(two))} here"
        raise InputError(problem, file=paths[-1])
    if alone := [one for one in found if one != first and not any(each.get(one) for each in compared.values())]:
        note(f"warning: not compared, no run in common with {first}: {', '.join(alone)}")
    titles = runs.headings(rows, list(compared))
    lines = _lines(axis, first, compared, titles, form, runs.also_of(found, axis))
    answer({"by": axis, "baseline": first, "metrics": compared}, lines, as_json=as_json)


def _lines(
    axis: str, first: str, compared: dict[str, dict[str, Any]], titles: Mapping[str, Shown], form: str, also: str
) -> Iterator[str]:
    """A table a metric, or of them all: a row a place of each configuration; and, as text, what else differs."""
    from moteslam.eval.statistics import FEWEST

    several = any(len(each) > 1 for pairs in compared.values() for each in pairs.values())

    def head(*shown: Shown) -> tuple[str, ...]:
        ways = [
            " or ".join(words)
            for words in (dict.fromkeys(each) for each in zip(*(one.ways for one in shown), strict=True))
        ]
        return (axis, *(["where"] if several else []), "pairs", *ways, *HEAD)

    def filled(rows: Rows) -> Rows:
        """Without the columns of failures and intervals that are empty in all of the rows."""
        empty = [k for k in (-1, -2, -4) if all(row[k] in ("0", "-") for row in rows[1:])]
        return [[one for k, one in enumerate(row, -len(row)) if k not in empty] for row in rows]

    tables: dict[str, list[tuple[str, ...]]] = {}
    for name, shown in titles.items():
        cells = tables[shown.title] = []
        for other, place, one in ((other, *item) for other, each in compared[name].items() for item in each.items()):
            counts = [str(count) for count in (*(one[count] for count in COUNTS), *one["failed"][::-1])]
            figures = (*counts[:-2], *shown.median(one, sign=True), f"{one['p']:.2g}", *counts[-2:])
            cells.append((other, *([place] if several else []), *figures))
    if form != "text":
        rows = ((title, *cell) for title, cells in tables.items() for cell in cells)
        table = [("metric", *head(*titles.values())), *rows]
        yield FORMATS[form](table if form == "csv" else filled(table))
    for shown in titles.values() if form == "text" else ():
        title, cells = shown.title, tables[shown.title]
        yield f"{title}, against {literal(first)}"
        yield aligned(filled([head(shown), *cells]))
    said = [] if form == "text" else [f"against {literal(first)}; p is of the sign test"]
    if any(one["pairs"] < FEWEST for pairs in compared.values() for each in pairs.values() for one in each.values()):
        said.append(f"fewer than {FEWEST} pairs have no 95 % interval")
    yield from (BETWEEN[form].format(one) for one in (*said, also) if one and BETWEEN[form])


def summed_up(store: Store, wanted: list[str] | None) -> tuple[dict[str, Any], dict[str, Shown]]:
    """A sweep's hash, its runs by status, and its groups with successes and summaries; how its metrics are shown."""
    from moteslam.eval import runs

    rows = [row for row in store.rows() if row.status]
    costs = [name for name in ("cpu_per_scan", "memory") if wanted is None and any(name in row.costs for row in rows)]
    names = list(dict.fromkeys([*runs.metric_names(wanted, rows), *costs]))
    groups = [
        {
            "group": dict(about),
            "runs": len(members),
            "driven_m": runs.driven(members),
            "driven_by": runs.driven_by(members),
            "success": None if (share := runs.success_of(members)) is None else share.as_dict(),
            "metrics": {name: asdict(runs.summary_of(members, name)) for name in names},
        }
        for about, members in runs.grouped(rows, lambda row: tuple(row.about.items())).items()
    ]
    counts = {name or "pending": count for name, count in store.counts().items()}
    found = {"hash": store.digest, "runs": counts, "success": store.success, "groups": groups}
    found["missing"] = runs.missing_of(rows) if wanted is None else {}
    found["warnings"] = runs.warnings_of(rows)
    return found, runs.headings(rows, names)


def summary_lines(found: dict[str, Any], titles: Mapping[str, Shown], form: str) -> Iterator[str]:
    """A row a group: of each metric the median with its interval, and the worst run."""
    from moteslam.eval.runs import grouped, success_words, unlike, varying
    from moteslam.eval.statistics import FEWEST, Proportion

    groups = found["groups"]
    if groups:
        about = varying([each["group"] for each in groups])
        alike = [key for key in about if len({str(each["group"].get(key, "")) for each in groups}) == 1]
        alike = alike if form != "csv" and len(groups) > 1 else []
        columns = [[key, *(str(each["group"].get(key, "")) for each in groups)] for key in about if key not in alike]
        columns.append(["runs", *(str(each["runs"]) for each in groups)])
        shares = [one and Proportion(one["count"], one["total"]) for one in (each["success"] for each in groups)]
        columns.append(["success", *("-" if one is None else f"{one.count}{one.range}" for one in shares)])
        places = grouped(groups, lambda each: str(each["group"].get("scenario"))).values()
        if any(unlike(each["driven_m"] for each in some) for some in places):
            by = " or ".join(sorted({each["driven_by"] for each in groups}))
            columns.append([f"way driven, by {by} [m]", *(number(each["driven_m"]) for each in groups)])
        few = form != "csv" and all(each["runs"] < FEWEST for each in groups)
        several = any(each["runs"] > 1 for each in groups)
        for name, shown in titles.items():
            medians, ranges = zip(*(shown.median(each["metrics"][name]) for each in groups), strict=True)
            if form == "latex" and not few:  # one head a metric
                columns.append([shown.title, *map("{} ({})".format, medians, ranges)])
            else:
                columns.append([shown.title, *medians])
                columns += [] if few else [[f"{shown.title} 95 %" if form == "csv" else "95 %", *ranges]]
            worst = (shown.text(each["metrics"][name]["worst"]) for each in groups)
            columns += [[f"{shown.title} worst" if form == "csv" else "worst", *worst]] * several
        yield FORMATS[form]([*zip(*columns, strict=True)])
        yield from (BETWEEN[form].format(f"{key} {literal(groups[0]['group'][key])} throughout") for key in alike)
        if form != "csv":
            fewer = f"; fewer than {FEWEST} runs have no 95 % interval"
            what = "medians" if few or form != "latex" else "medians (95 % intervals)"
            yield BETWEEN[form].format(what + fewer * any(each["runs"] < FEWEST for each in groups))
            missing = ", not measured" * any(each["success"] is None for each in groups)
            yield BETWEEN[form].format(f"success: {success_words(found['success'])}{missing}")
            for name, why in found["missing"].items():
                yield BETWEEN[form].format(f"no run has {name}: {literal(why)}")
    if form == "text":
        yield total(found)


def total(found: dict[str, Any]) -> str:
    """How many runs there are of each status."""
    names = {"pending": "not made yet"}
    return ", ".join(f"{count} {names.get(name, name)}" for name, count in found["runs"].items())


def report(
    paths: Annotated[list[Path], arg("Files of sweeps, result folders, and folders with either in them.", "PATH...")],
    out: Annotated[Path, opt("The page; it must not exist.", "FILE.html")] = Path("report.html"),
    title: Annotated[str | None, opt("Title of the page [what is compared].", "TEXT")] = None,
    metrics: options.Metrics = None,
    by: options.By = None,
    baseline: options.Baseline = None,
    force: options.ForceFile = False,
    as_json: options.Json = False,
) -> None:
    """Make one HTML page of sweeps and result folders.

    It has tables and charts, holds all that it shows and needs no network: open it in a browser, send it, print it. A
    player shows the runs of result folders; of a sweep's runs only figures are kept.

    \b
    Examples:
      moteslam report particles.sweep --out particles.html
      moteslam report result
      moteslam report before after --metric final.ate --metric map_f1 --title "before and after"
    """  # noqa: D301
    with options.new_file(out, ".html", ".htm", force=force), options.named(metrics="--metric"):
        from moteslam.eval.page.document import gather, page
        from moteslam.files import write_atomically
        from moteslam.robot.values import counted

        material = gather(paths)
        with progress_bar("reading runs", len(material.runs), "runs") as update:
            text = page(material, title=title, metrics=metrics or (), by=by, baseline=baseline, progress=update)
        write_atomically(out, text)
    size = len(text.encode())
    line = f"{counted(len(material.runs), 'run')} in {literal(out)} ({size / 1e6:.1f} MB)"
    answer({"file": str(out), "bytes": size, "runs": len(material.runs)}, [line], as_json=as_json)
