"""``moteslam sweep``: many runs of many configurations, summed up."""

from collections.abc import Iterable
from itertools import chain
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.compare import summary_lines, summed_up, total
from moteslam.eval.cli.interrupt import Interrupted
from moteslam.eval.cli.options import arg, flag, opt
from moteslam.eval.cli.text import answer, note, progress_bar, say, warn
from moteslam.eval.tables import Column, aligned, literal, rows_of


class RunByDefault(TyperGroup):
    """``sweep SPEC.toml`` is ``sweep run SPEC.toml``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        given = bool(args) and args[0] not in (*self.commands, "--help", "-h")
        return super().parse_args(ctx, ["run", *args] if given else args)


app = typer.Typer(
    cls=RunByDefault,
    help="Make many runs, and sum them up. They are over scenarios, recordings, robots, seeds and configurations. "
    "`moteslam sweep SPEC.toml` is `moteslam sweep run SPEC.toml`: its options are in `moteslam sweep run --help`.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

DIFFERENT = NOTHING = 1  # Exit codes
SPECS = (
    *(Column("name", "name"), Column("runs", "runs"), Column("hash", "hash", ".16")),
    Column("what it is for", "description"),
)
MOST_SHOWN = 40  # Differences in the table that is printed
File = Annotated[Path, arg("What `moteslam sweep` wrote.", "FILE.sweep")]


@app.command("run")
def run(
    spec: Annotated[str, arg("Which runs to make; NAME: see `sweep list`.", "SPEC.toml|NAME")],
    out: Annotated[
        Path | None, opt("Where to record them [SPEC.sweep]; an existing one goes on.", "FILE.sweep")
    ] = None,
    workers: Annotated[int | None, opt("Parallel runs [as many as there are processors].", min=1, max=1024)] = None,
    shard: Annotated[str | None, opt("Only the I-th of N parts, for job arrays; see `sweep merge`.", "I/N")] = None,
    timed: Annotated[
        bool, flag("--time", "Also measure time and memory: one run at a time, each in a new process.")
    ] = False,
    scheduler: Annotated[
        str | None, opt("Make the runs on this Dask cluster (extra `cluster`).", "tcp://HOST:PORT")
    ] = None,
    as_json: options.Json = False,
) -> None:
    """Make the runs of a specification, record each as it ends, and print a summary.

    Killed at any moment and started again, it goes on where it was: no run that ended well is lost or made again. A run
    that fails, crashes or takes too long is recorded with its error, and tried again the next time. Whatever the number
    of workers, parts and interruptions, the results are the same bit for bit. Exit code 1 if no run ended well.

    \b
    Examples:
      moteslam sweep particles.toml
      moteslam sweep corridor-suite-1
      moteslam sweep particles.toml --shard 2/8 --out part2.sweep
      moteslam sweep particles.toml --scheduler tcp://head:8786
    """  # noqa: D301
    from moteslam.eval.results import environment
    from moteslam.eval.sweep.spec import read_spec, spec_file
    from moteslam.eval.sweep.store import WHOLE, begin, opened
    from moteslam.eval.sweep.workers import make_all, make_all_on
    from moteslam.robot.values import counted, processor_count

    if timed and workers not in (None, 1):
        raise ConfigError("given with --workers, expected one run at a time", field="--time")
    if scheduler is not None and workers is not None:
        raise ConfigError("given with --scheduler, whose workers are the cluster's", field="--workers")
    file = spec_file(spec)
    wanted = read_spec(file)
    beside = file.with_suffix(".sweep") if file == Path(spec) else Path(f"{spec}.sweep")
    target = beside if out is None else out
    begin(target, file, wanted, shard or WHOLE, environment())
    with opened(target, write=True) as store:
        runs = store.pending(again=True)
        if again := len(runs) - store.counts().get("", 0):
            note(f"tried again: {counted(again, 'run')} that did not end well")
        done = sum(store.counts().values()) - len(runs)
        with progress_bar("sweep", done + len(runs), "runs") as update:
            update(done)
            limits: dict[str, Any] = {"timeout": wanted.timeout, "timed": timed}
            outcomes = make_all(runs, workers=1 if timed else workers or processor_count(), **limits)
            if scheduler is not None:
                outcomes = make_all_on(scheduler, runs, **limits)
            try:
                for outcome in outcomes:
                    store.record(outcome)
                    done += 1
                    update(done)
                    if outcome.error:
                        note(f"warning: {outcome.run.name}: {outcome.status}: {outcome.error}")
            except (Interrupted, KeyboardInterrupt) as error:
                error.add_note(f"interrupted, {counted(done, 'run')} in {target}: the same command goes on")
                raise
        found, titles = summed_up(store, None)
    lines = chain(summary_lines(found, titles, "text"), [f"recorded in {literal(target)}"])
    _tell(found, lines, as_json=as_json)
    if found["runs"].keys() - {"ok", "pending"} and "ok" not in found["runs"]:
        raise typer.Exit(NOTHING)


@app.command("list")
def list_specs(
    name: Annotated[str | None, arg("Print this one as TOML, to be changed.", "[NAME]")] = None,
    as_json: options.Json = False,
) -> None:
    """List the specifications that come with moteslam, or print one.

    Each has its number of runs, the first digits of the hash of all that determines them (all digits with --json), and
    its purpose.

    \b
    Examples:
      moteslam sweep list
      moteslam sweep list particles > mine.toml
    """  # noqa: D301
    from moteslam.eval.sweep.plan import digest, plan
    from moteslam.eval.sweep.spec import bundled_specs, read_spec, spec_file

    if name is not None:
        text = spec_file(name).read_text(encoding="utf-8")
        answer({"name": name, "toml": text}, [text.rstrip("\n")], as_json=as_json)
        return
    found: list[dict[str, Any]] = []
    for each, file in bundled_specs().items():
        spec = read_spec(file)
        runs = plan(spec, check=False)
        found.append({"name": each, "runs": len(runs), "hash": digest(runs), "description": spec.description})
    answer(found, [aligned(rows_of(SPECS, found))], as_json=as_json)


@app.command("show")
def show(
    file: File, metrics: options.Metrics = None, form: options.Format = "text", as_json: options.Json = False
) -> None:
    """Sum up the runs recorded so far: successes, medians with their 95 % intervals, worst; quartiles in --json.

    \b
    Examples:
      moteslam sweep show particles.sweep
      moteslam sweep show particles.sweep --metric final.ate --metric map_f1
      moteslam sweep show particles.sweep --format latex > table.tex
    """  # noqa: D301
    from moteslam.eval.runs import metric_names
    from moteslam.eval.sweep.store import opened

    metric_names(metrics)
    with opened(file) as store:
        found, titles = summed_up(store, metrics)
    _tell(found, summary_lines(found, titles, form), as_json=as_json)
    if not as_json and form != "text" and set(found["runs"]) != {"ok"}:
        note(f"warning: {file}: {total(found)}")


def _tell(found: dict[str, Any], lines: Iterable[str], *, as_json: bool) -> None:
    """The summary, and what is doubtful in the runs."""
    warn(() if as_json else found["warnings"])
    answer(found, lines, as_json=as_json)


@app.command("plot")
def plot(
    file: File,
    out: Annotated[Path, opt("A new file.", "FILE.png|pdf|svg")],
    metrics: Annotated[
        list[str] | None, opt("Metric to draw [the first that the sweep names]; repeatable.", "NAME", "--metric")
    ] = None,
    along: Annotated[str | None, opt("Column on the x axis [the varied key].", "COLUMN", "--x")] = None,
    label: Annotated[str | None, opt("Label of that axis [the key].", "TEXT")] = None,
    force: options.ForceFile = False,
) -> None:
    """Draw medians with their 95 % intervals over a varied key, a line for each scenario, robot and configuration.

    Axes are logarithmic if values are far apart. If no key varies, the x axis has the configurations, or if there is
    only one, the robots. --x names another column of `sweep show`.

    \b
    Examples:
      moteslam sweep plot particles.sweep --out particles.png
      moteslam sweep plot range.sweep --metric final.ate --metric map_f1 --label "reach [m]" --out range.png
    """  # noqa: D301
    from moteslam.eval.report.curves import draw_sweep
    from moteslam.eval.runs import axis_of, metric_names, read_runs, varying

    metric_names(metrics)  # before the file is read
    with options.new_file(out, *options.FIGURES, force=force):
        rows = [row for row in read_runs([file]) if row.status]
        if not rows:
            raise InputError("no run was made yet, expected some", file=file)
        names = metric_names(metrics, rows) if metrics else metric_names(None, rows)[:1]
        known = varying([row.about for row in rows])
        column = along or next((key for row in rows for key, _ in row.run.varied), axis_of(rows))
        if column not in known:
            raise ConfigError(f"{column!r}, expected one of {', '.join(known)}", field="--x")
        for name in names:
            if not any(row.status == "ok" and name in row.known for row in rows):
                raise InputError(f"no run that ended well has {name}, expected a metric of the sweep", file=file)
        draw_sweep(out, rows, names, column=column, label=label)
        for left in dict.fromkeys(row.run.configuration for row in rows if column not in row.about):
            note(f"warning: not drawn, has no {column}: {literal(left)}")
    say(f"wrote {literal(out)}")


@app.command("merge")
def merge_files(
    files: Annotated[list[Path], arg("Parts of one sweep, or one of them.", "FILE.sweep...")],
    out: Annotated[Path, opt("A new file for all of their runs.", "FILE.sweep")],
) -> None:
    """Join the parts of a sweep that `--shard` made, on one computer or on many.

    \b
    Examples:
      moteslam sweep merge part1.sweep part2.sweep part3.sweep --out all.sweep
    """  # noqa: D301
    from moteslam.eval.sweep.store import merge

    counts = merge(files, out)
    missing = counts.pop("", 0)
    say(f"{sum(counts.values())} runs in {literal(out)}" + (f", {missing} not made yet" if missing else ""))


@app.command("diff")
def diff(
    file: File,
    other: Annotated[Path, arg("Another one, or a table that `sweep export` wrote.", "OTHER")],
    as_json: options.Json = False,
) -> None:
    """Print where two sweeps of the same runs differ in any digit, except in times and memory.

    The same code gives the same results with the same versions of NumPy, pymunk and Taichi. Exit code 1 if they
    differ.

    \b
    Examples:
      moteslam sweep diff mine.sweep published.csv
    """  # noqa: D301
    from moteslam.eval.sweep.store import differences, read_table
    from moteslam.robot.values import counted

    first, second = read_table(file), read_table(other)
    common = first.keys() & second.keys()
    if not common:
        raise InputError("no run in common with it, expected a sweep of the same specification", file=other)
    alone, cells = len(first) + len(second) - 2 * len(common), differences(first, second)
    found = {"runs": len(common), "in_one_alone": alone, "differences": cells}
    more = f", {alone} in one of the two alone" if alone else ""
    rows = [("run", "column", str(file), str(other)), *(tuple(cell.values()) for cell in cells[:MOST_SHOWN])]
    lines = [aligned(rows)] if cells else []
    lines += [f"... and {len(cells) - MOST_SHOWN} more: --json has all"] * (len(cells) > MOST_SHOWN)
    lines += [f"{counted(len(cells), 'difference')} in {counted(len(common), 'run')}{more}"]
    answer(found, lines, as_json=as_json)
    if cells:
        raise typer.Exit(DIFFERENT)


@app.command("export")
def export(
    file: File,
    out: Annotated[Path, opt("A new .csv or .parquet file (Parquet needs pyarrow).", "FILE")],
    force: options.ForceFile = False,
) -> None:
    """Write one row per run: what it is, how it ended, every metric, and times in the last columns.

    \b
    Examples:
      moteslam sweep export particles.sweep --out particles.csv
      moteslam sweep export particles.sweep --out particles.parquet
    """  # noqa: D301
    from moteslam.eval.runs import read_runs
    from moteslam.eval.sweep.store import as_csv, write_parquet
    from moteslam.files import write_atomically

    with options.new_file(out, ".csv", ".parquet", force=force):
        rows = read_runs([file])
        if out.suffix == ".csv":
            write_atomically(out, as_csv(rows))
        else:
            write_parquet(out, rows)
    say(f"{len(rows)} runs in {literal(out)}")
