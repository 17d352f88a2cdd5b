"""``moteslam sweep``: many runs of many configurations, and what they came to."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
from typer.core import TyperGroup

from moteslam.errors import ConfigError, ExistsError, InputError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.interrupt import Interrupted
from moteslam.eval.cli.text import literal, note, say, say_json, table

if TYPE_CHECKING:
    from moteslam.eval.sweep.spec import SweepSpec
    from moteslam.eval.sweep.store import Store
    from moteslam.eval.sweep.tables import GroupSummary


class RunByDefault(TyperGroup):
    """``sweep SPEC.toml`` is ``sweep run SPEC.toml``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``run`` before what is no command."""
        if args and args[0] not in self.commands and args[0] not in ("--help", "-h"):
            args = ["run", *args]
        return super().parse_args(ctx, args)


app = typer.Typer(
    cls=RunByDefault,
    help="Make many runs, over scenarios, recordings, robots, seeds and configurations, and sum them up.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

MOST_SHOWN = 40
"""Differences in the table that is printed."""
DIFFERENT = 1
"""Exit code."""
File = Annotated[Path, typer.Argument(metavar="FILE.sweep", help="What `moteslam sweep` wrote.")]


@app.command("run")
def run(
    spec: Annotated[Path, typer.Argument(metavar="SPEC.toml", help="Which runs there are to make.")],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.sweep", help="Where they are recorded [SPEC.sweep]; goes on if it is there."),
    ] = None,
    workers: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Runs at a time [as many as there are processors].")
    ] = None,
    shard: Annotated[
        str | None, typer.Option(metavar="I/N", help="Only the I-th of N parts, for job arrays; see `sweep merge`.")
    ] = None,
    timed: Annotated[
        bool, typer.Option("--time", help="Measure time and memory too: one run at a time, each in a new process.")
    ] = False,
    scheduler: Annotated[
        str | None,
        typer.Option(metavar="tcp://HOST:PORT", help="Make the runs on this Dask cluster (extra `cluster`)."),
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Make the runs of a specification, record each as it ends, and print what they came to.

    Killed at any moment and started again, it goes on where it was: no run that was recorded is lost or made again. A
    run that fails, crashes or takes too long is recorded with its error. The results are the same, bit for bit,
    whatever the number of workers, parts and interruptions.

    \b
    Examples:
      moteslam sweep particles.toml
      moteslam sweep particles.toml --workers 1 --time --out timed.sweep
      moteslam sweep particles.toml --shard 2/8 --out part2.sweep
      moteslam sweep particles.toml --scheduler tcp://head:8786
    """  # noqa: D301
    from moteslam.eval.cli.progress import progress_bar
    from moteslam.eval.sweep.cluster import make_all_on
    from moteslam.eval.sweep.spec import read_spec
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.workers import make_all
    from moteslam.robot.processors import processor_count
    from moteslam.robot.wording import counted

    if timed and workers not in (None, 1):
        raise ConfigError("given with --workers, expected one run at a time", field="--time")
    if scheduler is not None and workers is not None:
        raise ConfigError("given with --scheduler, whose workers are the cluster's", field="--workers")
    wanted = read_spec(spec)
    target = spec.with_suffix(".sweep") if out is None else out
    _begun(target, spec, wanted, shard)
    count = 1 if timed else workers or processor_count()
    with opened(target, write=True) as store:
        runs = store.pending()
        done = sum(store.counts().values()) - len(runs)
        with progress_bar("sweep", done + len(runs), "runs") as bar:
            bar.update(done)
            outcomes = (
                make_all(runs, workers=count, timeout=wanted.timeout, timed=timed)
                if scheduler is None
                else make_all_on(scheduler, runs, timeout=wanted.timeout, timed=timed)
            )
            try:
                for outcome in outcomes:
                    store.record(outcome)
                    done += 1
                    bar.update(done)
                    if outcome.error:
                        note(f"warning: {outcome.run.name}: {outcome.status}: {outcome.error}")
            except (Interrupted, KeyboardInterrupt) as error:
                error.add_note(f"interrupted, {counted(done, 'run')} in {target}: the same command goes on")
                raise
        _say(store, wanted, as_json=as_json)
    if not as_json:
        say(f"recorded in {literal(target)}")


@app.command("show")
def show(
    file: File,
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Which metrics [final.ate]; repeatable.")
    ] = None,
    budget: Annotated[
        str | None, typer.Option(metavar="TIME", help="The best configuration within this processor time a scan.")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Print what the runs recorded so far came to: median with its 95 % interval, quartiles, successes.

    With --budget, of a sweep made with --time: the configurations that cost at most that much, the best first, and
    in how many of the same runs the best one beats each.

    \b
    Examples:
      moteslam sweep show particles.sweep
      moteslam sweep show particles.sweep --metric final.ate --metric map_f1
      moteslam sweep show timed.sweep --budget 10ms
    """  # noqa: D301
    from moteslam.eval.metrics.registry import chosen
    from moteslam.eval.sweep.store import opened

    chosen(metrics)
    if budget is not None:
        _say_affordable(file, budget, metrics or ["final.ate"], as_json=as_json)
        return
    with opened(file) as store:
        _say(store, _spec_of(store), metrics=metrics, as_json=as_json)


@app.command("merge")
def merge(
    files: Annotated[list[Path], typer.Argument(metavar="FILE.sweep...", help="Parts of one sweep, or one of them.")],
    out: Annotated[Path, typer.Option(metavar="FILE.sweep", help="A new file for all of their runs.")],
) -> None:
    """Put the parts of a sweep together that `--shard` made, on one computer or on many.

    \b
    Examples:
      moteslam sweep merge part1.sweep part2.sweep part3.sweep --out all.sweep
    """  # noqa: D301
    from moteslam.eval.sweep.plan import plan
    from moteslam.eval.sweep.store import create, opened

    if out.exists():
        raise ExistsError("exists already; name a new file", file=out)
    with opened(files[0]) as first:
        text, spec = first.spec, _spec_of(first)
    for file in files[1:]:
        with opened(file) as other:
            if other.spec != text:
                raise InputError("of another sweep, expected parts of one", file=file)
    partial = out.with_name(f".{out.name}.merging")
    create(partial, text, plan(spec, check=False))
    try:
        with opened(partial, write=True) as store:
            for file in files:
                with opened(file) as other:
                    store.take(other)
            counts = store.counts()
        partial.replace(out)
    finally:
        partial.unlink(missing_ok=True)
    missing = counts.pop("", 0)
    say(f"{sum(counts.values())} runs in {literal(out)}" + (f", {missing} not made yet" if missing else ""))


@app.command("diff")
def diff(
    file: File,
    other: Annotated[Path, typer.Argument(metavar="OTHER", help="Another one, or a table that `sweep export` wrote.")],
    as_json: options.Json = False,
) -> None:
    """Print where two sweeps of the same runs differ, in any digit; times and memory are left out.

    The same code gives the same results on any computer. Exit code 1 where they differ.

    \b
    Examples:
      moteslam sweep diff mine.sweep published.csv
    """  # noqa: D301
    from moteslam.eval.sweep.differences import differences, read_table
    from moteslam.robot.wording import counted

    first, second = read_table(file), read_table(other)
    common = [run for run in first if run in second]
    if not common:
        raise InputError("no run in common with it, expected a sweep of the same specification", file=other)
    found = differences(first, second)
    missing = len(first) + len(second) - 2 * len(common)
    if as_json:
        say_json({"runs": len(common), "in_one_alone": missing, "differences": [asdict(each) for each in found]})
    else:
        if found:
            rows: list[tuple[str, ...]] = [("run", "column", literal(file), literal(other))]
            rows += [
                tuple(map(literal, (each.run, each.column, each.first, each.second))) for each in found[:MOST_SHOWN]
            ]
            say(table(rows))
        if len(found) > MOST_SHOWN:
            say(f"... and {len(found) - MOST_SHOWN} more: --json has all")
        alone = f", {missing} in one of the two alone" if missing else ""
        say(f"{counted(len(found), 'difference')} in {counted(len(common), 'run')}{alone}")
    if found:
        raise typer.Exit(DIFFERENT)


@app.command("export")
def export(
    file: File,
    out: Annotated[Path, typer.Option(metavar="FILE", help="A new .csv or .parquet file (Parquet needs pyarrow).")],
    force: Annotated[bool, typer.Option("--force", help="Replace an existing file.")] = False,
) -> None:
    """Write a row a run: what it is, what became of it, every metric, and times in columns at the end.

    \b
    Examples:
      moteslam sweep export particles.sweep --out particles.csv
      moteslam sweep export particles.sweep --out particles.parquet
    """  # noqa: D301
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.tables import as_csv, columns
    from moteslam.robot.files import write_atomically

    options.refuse_existing(out, force=force)
    if out.suffix not in (".csv", ".parquet"):
        raise OutputError("expected a name that ends in .csv or .parquet", file=out)
    with opened(file) as store:
        rows = list(store.rows())
    if out.suffix == ".csv":
        write_atomically(out, as_csv(rows))
    else:
        _write_parquet(out, columns(rows))
    say(f"{len(rows)} runs in {literal(out)}")


def _begun(target: Path, file: Path, spec: SweepSpec, part: str | None) -> None:
    """Make the file of the sweep, unless it is there already."""
    from moteslam.eval.sweep.plan import plan
    from moteslam.eval.sweep.plan import shard as shard_of
    from moteslam.eval.sweep.store import create, opened

    text = spec.model_dump_json(exclude_defaults=True)
    if target.exists():
        with opened(target) as store:
            if store.spec != text:
                raise ExistsError("is of another specification; name a new file with --out", file=target)
        return
    try:
        runs = plan(spec)
    except ConfigError as error:
        raise ConfigError(error.problem, file=error.file or file, field=error.field) from error
    if part is not None:
        number, of = _part(part)
        runs = shard_of(runs, number, of)
    create(target, text, runs)


def _part(text: str) -> tuple[int, int]:
    first, slash, second = text.partition("/")
    if slash and first.isdecimal() and second.isdecimal() and 1 <= int(first) <= int(second):
        return int(first), int(second)
    raise ConfigError(f"{text!r}, expected a part and how many there are, such as 2/8", field="--shard")


def _spec_of(store: Store) -> SweepSpec:
    from moteslam.eval.sweep.spec import SweepSpec

    return SweepSpec.model_validate_json(store.spec)


def _say(store: Store, spec: SweepSpec, *, metrics: list[str] | None = None, as_json: bool) -> None:
    from moteslam.eval.sweep.tables import summaries

    names = metrics or ["final.ate"]
    counts = store.counts()
    found = summaries(store.rows(), names, dict(spec.success))
    if as_json:
        say_json(
            {"runs": {name or "pending": count for name, count in counts.items()}, "groups": list(map(_as_dict, found))}
        )
        return
    if found:
        say(_table(found, names))
    say(", ".join(f"{count} {name or 'not made yet'}" for name, count in counts.items()))


def _say_affordable(file: Path, text: str, metrics: list[str], *, as_json: bool) -> None:
    from moteslam.eval.populations import populations
    from moteslam.eval.sweep.budget import affordable, parse_budget

    budget = parse_budget(text)
    if len(metrics) > 1:
        raise ConfigError("more than one with --budget, expected what the best is chosen by", field="--metric")
    try:
        choices = affordable(populations([file]), budget, metrics[0])
    except InputError as error:
        raise InputError(error.problem, file=file, field=error.field) from error
    if as_json:
        say_json(
            [
                {
                    "configuration": each.name,
                    "cpu_per_scan_ms": each.cost,
                    metrics[0]: each.value.as_dict(),
                    "best_against_it": None if each.against is None else each.against.as_dict(),
                }
                for each in choices
            ]
        )
        return
    rows = [("configuration", "ms a scan", metrics[0], "95 %", "the best beats it in")]
    for each in choices:
        beaten = "" if each.against is None else f"{each.against.wins} of {each.against.pairs}, p {each.against.p:.2g}"
        interval = f"{_number(each.value.low)} to {_number(each.value.high)}"
        rows.append((literal(each.name), f"{each.cost:.3g}", _number(each.value.median), interval, beaten))
    say(table(rows, right=(1,)))


def _as_dict(group: GroupSummary) -> dict[str, Any]:
    return {
        "group": group.about,
        "runs": group.runs,
        "success": None if group.success is None else group.success.as_dict(),
        "metrics": {name: summary.as_dict() for name, summary in group.values.items()},
    }


def _table(groups: list[GroupSummary], names: list[str]) -> str:
    about = [key for key in groups[0].about if any(group.about.get(key) for group in groups)]
    head = [*about, "runs", "success"]
    for name in names:
        head += [name, "95 %", "quartiles"]
    rows = [head]
    for group in groups:
        success = "-" if group.success is None else _share(group.success.interval)
        row = [str(group.about.get(key, "")) for key in about]
        row += [str(group.runs), success if group.success is None else f"{group.success.count} ({success})"]
        for name in names:
            summary = group.values[name]
            row += [
                _number(summary.median),
                f"{_number(summary.low)} to {_number(summary.high)}",
                f"{_number(summary.low_quartile)} to {_number(summary.high_quartile)}",
            ]
        rows.append(row)
    return table([list(map(literal, row)) for row in rows])


def _share(interval: tuple[float, float]) -> str:
    return f"{100 * interval[0]:.0f} to {100 * interval[1]:.0f} %"


def _number(value: float | None) -> str:
    return "-" if value is None else "failed" if abs(value) == float("inf") else f"{value:.4g}"


def _write_parquet(path: Path, table_of: dict[str, list[Any]]) -> None:
    try:
        import pyarrow
        from pyarrow import parquet
    except ImportError as error:
        raise OutputError("needs pyarrow, expected it installed: pip install 'moteslam[parquet]'", file=path) from error
    partial = path.with_name(f".{path.name}.partial")
    try:
        parquet.write_table(pyarrow.table(table_of), partial)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)
