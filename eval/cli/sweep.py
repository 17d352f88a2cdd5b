"""``moteslam sweep``: many runs of many configurations, and what they came to."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.interrupt import Interrupted
from moteslam.eval.cli.sweep_file import begin, spec_of
from moteslam.eval.cli.sweep_plot import plot_sweep
from moteslam.eval.cli.sweep_tables import say_affordable, say_differences, say_specs, say_summaries
from moteslam.eval.cli.text import note, say, say_json
from moteslam.eval.literal import literal


class RunByDefault(TyperGroup):
    """``sweep SPEC.toml`` is ``sweep run SPEC.toml``."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Put ``run`` before what is no command."""
        given = bool(args) and args[0] not in (*self.commands, "--help", "-h")
        return super().parse_args(ctx, ["run", *args] if given else args)


app = typer.Typer(
    cls=RunByDefault,
    help="Make many runs, over scenarios, recordings, robots, seeds and configurations, and sum them up. "
    "`moteslam sweep SPEC.toml` is `moteslam sweep run SPEC.toml`: its options are in `moteslam sweep run --help`.",
    no_args_is_help=True,
    rich_markup_mode=None,
)

DIFFERENT = NOTHING = 1
"""Exit codes."""
File = Annotated[Path, typer.Argument(metavar="FILE.sweep", help="What `moteslam sweep` wrote.")]


@app.command("run")
def run(
    spec: Annotated[
        str, typer.Argument(metavar="SPEC.toml|NAME", help="Which runs there are to make; NAME: see `sweep list`.")
    ],
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
    whatever the number of workers, parts and interruptions. Exit code 1 where no run ended well.

    \b
    Examples:
      moteslam sweep particles.toml
      moteslam sweep corridor-suite-1
      moteslam sweep particles.toml --workers 1 --time --out timed.sweep
      moteslam sweep particles.toml --shard 2/8 --out part2.sweep
      moteslam sweep particles.toml --scheduler tcp://head:8786
    """  # noqa: D301
    from moteslam.eval.cli.progress import progress_bar
    from moteslam.eval.sweep.bundled import spec_file
    from moteslam.eval.sweep.cluster import make_all_on
    from moteslam.eval.sweep.spec import read_spec
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.workers import make_all
    from moteslam.robot.values import counted, processor_count

    if timed and workers not in (None, 1):
        raise ConfigError("given with --workers, expected one run at a time", field="--time")
    if scheduler is not None and workers is not None:
        raise ConfigError("given with --scheduler, whose workers are the cluster's", field="--workers")
    file = spec_file(spec)
    wanted = read_spec(file)
    beside = file.with_suffix(".sweep") if file == Path(spec) else Path(f"{spec}.sweep")
    target = beside if out is None else out
    begin(target, file, wanted, shard)
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
        say_summaries(store, wanted, None, "json" if as_json else "text")
        ends = {status for status, count in store.counts().items() if status and count}
    if not as_json:
        say(f"recorded in {literal(target)}")
    if ends and "ok" not in ends:
        raise typer.Exit(NOTHING)


@app.command("list")
def list_specs(
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="Print this one as TOML, to change it.")] = None,
    as_json: options.Json = False,
) -> None:
    """List the specifications that come with moteslam, or print one.

    Of each: how many runs it has, the first digits of the hash of all that these follow from (all with --json), and
    what it is for.

    \b
    Examples:
      moteslam sweep list
      moteslam sweep list particles > mine.toml
    """  # noqa: D301
    from moteslam.eval.sweep.bundled import bundled_spec

    if name is None:
        say_specs(as_json=as_json)
        return
    text = bundled_spec(name).read_text(encoding="utf-8")
    if as_json:
        say_json({"name": name, "toml": text})
    else:
        say(text.rstrip("\n"))


@app.command("show")
def show(
    file: File,
    metrics: Annotated[
        list[str] | None, typer.Option("--metric", metavar="NAME", help="Which metrics [final.ate]; repeatable.")
    ] = None,
    budget: Annotated[
        str | None, typer.Option(metavar="TIME", help="The best configuration within this processor time a scan.")
    ] = None,
    form: options.Format = None,
    as_json: options.Json = False,
) -> None:
    """Print what the runs recorded so far came to: median with its 95 % interval, quartiles, successes.

    With --budget, of a sweep made with --time: the configurations that cost at most that much, the best first, and
    in how many of the same runs the best one beats each.

    \b
    Examples:
      moteslam sweep show particles.sweep
      moteslam sweep show particles.sweep --metric final.ate --metric map_f1
      moteslam sweep show particles.sweep --format latex > table.tex
      moteslam sweep show timed.sweep --budget 10ms
    """  # noqa: D301
    from moteslam.eval.metrics.registry import chosen
    from moteslam.eval.sweep.store import opened

    chosen(metrics)
    form = options.chosen_format(form, as_json=as_json)
    if budget is not None:
        say_affordable(file, budget, metrics or ["final.ate"], form)
        return
    with opened(file) as store:
        say_summaries(store, spec_of(store), metrics, form)


@app.command("plot")
def plot(
    file: File,
    out: Annotated[Path, typer.Option(metavar="FILE.png", help="A new file.")],
    metrics: Annotated[
        list[str] | None,
        typer.Option("--metric", metavar="NAME", help="Which metrics [final.ate]; repeatable, a panel each."),
    ] = None,
    along: Annotated[
        str | None, typer.Option("--x", metavar="COLUMN", help="What it is drawn over [the key that varies].")
    ] = None,
    label: Annotated[str | None, typer.Option(metavar="TEXT", help="Of that axis [the key].")] = None,
    title: Annotated[str, typer.Option(metavar="TEXT", help="Over the figure.")] = "",
    force: options.ForceFile = False,
) -> None:
    """Draw medians with their 95 % intervals over what varies, a line for each scenario and configuration.

    Axes are logarithmic where values are far apart. Where no key varies, --x names a column of `sweep show`, such as
    configuration.

    \b
    Examples:
      moteslam sweep plot particles.sweep --out particles.png
      moteslam sweep plot range.sweep --metric final.ate --metric map_f1 --label "reach [m]" --out range.png
    """  # noqa: D301
    from moteslam.eval.metrics.registry import chosen

    chosen(metrics)
    options.refuse_existing(out, force=force)
    options.expect_picture(out)
    plot_sweep(file, out, metrics or ["final.ate"], along, label=label, title=title)
    say(f"wrote {literal(out)}")


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
        raise OutputError("exists already, expected a new file", file=out)
    with opened(files[0]) as first:
        text, spec, digest, environment = first.spec, spec_of(first), first.digest, first.environment
    for file in files[1:]:
        with opened(file) as other:
            if (other.spec, other.digest) != (text, digest):
                raise InputError("of another sweep, expected parts of one", file=file)
    partial = out.with_name(f".{out.name}.merging")
    create(partial, text, plan(spec, check=False), digest=digest, environment=environment)
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

    The same code gives the same results with the same versions of NumPy, pymunk and Taichi. Exit code 1 where they
    differ.

    \b
    Examples:
      moteslam sweep diff mine.sweep published.csv
    """  # noqa: D301
    from moteslam.eval.sweep.differences import differences, read_table

    first, second = read_table(file), read_table(other)
    common = [run for run in first if run in second]
    if not common:
        raise InputError("no run in common with it, expected a sweep of the same specification", file=other)
    found = differences(first, second)
    say_differences(found, (file, other), len(common), len(first) + len(second) - 2 * len(common), as_json=as_json)
    if found:
        raise typer.Exit(DIFFERENT)


@app.command("export")
def export(
    file: File,
    out: Annotated[Path, typer.Option(metavar="FILE", help="A new .csv or .parquet file (Parquet needs pyarrow).")],
    force: options.ForceFile = False,
) -> None:
    """Write a row a run: what it is, what became of it, every metric, and times in columns at the end.

    \b
    Examples:
      moteslam sweep export particles.sweep --out particles.csv
      moteslam sweep export particles.sweep --out particles.parquet
    """  # noqa: D301
    from moteslam.eval.sweep.store import opened
    from moteslam.eval.sweep.tables import as_csv, write_parquet
    from moteslam.robot.files import write_atomically

    options.refuse_existing(out, force=force)
    if out.suffix not in (".csv", ".parquet"):
        raise OutputError("expected a name that ends in .csv or .parquet", file=out)
    with opened(file) as store:
        rows = list(store.rows())
    if out.suffix == ".csv":
        write_atomically(out, as_csv(rows))
    else:
        write_parquet(out, rows)
    say(f"{len(rows)} runs in {literal(out)}")
