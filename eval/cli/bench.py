"""``moteslam bench``: how fast this computer runs the kernels and whole runs, beside plain C."""

from __future__ import annotations

from contextlib import nullcontext
from pathlib import Path
from typing import Annotated

import typer

from moteslam.errors import ConfigError
from moteslam.eval.cli import options
from moteslam.eval.cli.groups import RunByDefault
from moteslam.eval.cli.text import note, say
from moteslam.eval.literal import literal

HELP = """Measure the speed of this computer's moteslam, beside plain C loops and the programs of others.

`moteslam bench` is `moteslam bench run`, whose --help has all options.

\b
Examples:
  moteslam bench                                  all tasks, about two minutes
  moteslam bench --quick                          a trial of half a minute
  moteslam bench --out mine.json                  a file to share
  moteslam bench compare theirs.json mine.json
"""

app = typer.Typer(cls=RunByDefault, help=HELP, rich_markup_mode=None)

FAILED = 1
"""Exit code where a task or a program failed."""
File = Annotated[Path, typer.Argument(metavar="FILE.json", help="What `moteslam bench --out` wrote.")]


@app.command("run")
def run(
    out: Annotated[Path | None, typer.Option(metavar="FILE.json", help="A new file for the result.")] = None,
    quick: Annotated[bool, typer.Option("--quick", help="A trial: few turns in one round.")] = False,
    tasks: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME,...", help="Only these tasks; a name that there is not lists them all."),
    ] = None,
    threads: Annotated[
        list[int] | None,
        typer.Option(
            metavar="N", min=1, max=1024, help="Numbers of threads; repeatable [1 and as many as processors]."
        ),
    ] = None,
    rounds: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, max=100, help="Processes for each number of threads [3, with --quick 1]."),
    ] = None,
    peers: Annotated[
        Path | None,
        typer.Option(metavar="SPEC.toml", help="SLAM programs of others: the commands of a sweep's specification."),
    ] = None,
    form: options.Format = None,
    as_json: options.Json = False,
    force: options.ForceOut = False,
) -> None:
    """Measure kernels and whole runs, and print what each takes beside the same work in plain C.

    The C loops are compiled by the C compiler of this computer (CC, gcc, clang or cc), if it has one, and must give the
    same results. Contenders take turns; medians count. Each number of threads has processes of its own. The result
    holds the versions, the hardware and all spreads, but no name of a host, a user or a folder. Exit code 1 where a
    task failed.

    \b
    Examples:
      moteslam bench
      moteslam bench --quick --tasks registration,integration
      moteslam bench --threads 1 --threads 2 --out mine.json
      moteslam bench --peers mrpt.toml --tasks run-30
      moteslam bench --format markdown
    """  # noqa: D301
    from moteslam.eval.bench.document import write_result
    from moteslam.eval.bench.measure import ROUNDS, Wanted, measure
    from moteslam.eval.bench.peers import read_peers
    from moteslam.eval.bench.workload import chosen
    from moteslam.eval.cli.bench_tables import failures, say_result
    from moteslam.eval.cli.progress import progress_bar
    from moteslam.robot.files import expect_writable, folder_for
    from moteslam.robot.processors import processor_count

    form = options.chosen_format(form, as_json=as_json)
    options.refuse_existing(out, force=force)
    names = [name.strip() for words in tasks or [] for name in words.split(",")]
    try:
        known = chosen(names)
    except ConfigError as error:
        raise ConfigError(error.problem, field="--tasks") from error
    counts = sorted({1, processor_count()} if threads is None else set(threads))
    if counts[-1] > processor_count():
        raise ConfigError(f"{counts[-1]}, expected at most the {processor_count()} processors", field="--threads")
    wanted = Wanted(
        known,
        counts,
        rounds or (1 if quick else ROUNDS),
        quick,
        [] if peers is None else read_peers(peers),
    )

    with nullcontext() if out is None else folder_for(out):
        if out is not None:
            expect_writable(out)
        with progress_bar("bench", wanted.steps, "") as bar:
            result = measure(wanted, bar.update)
        if out is not None:
            write_result(out, result)
    errors = failures(result)
    for warning in (*result.warnings, *(f"{name}: {error}" for name, error in errors)):
        note(f"warning: {warning}")
    say_result(result, form)
    if out is not None and form == "text":
        say(f"wrote {literal(out)}")
    if errors:
        raise typer.Exit(FAILED)


@app.command("show")
def show(file: File, form: options.Format = None, as_json: options.Json = False) -> None:
    """Print a result that was written before, here or elsewhere.

    \b
    Examples:
      moteslam bench show mine.json
      moteslam bench show theirs.json --format latex > table.tex
    """  # noqa: D301
    from moteslam.eval.bench.document import read_result
    from moteslam.eval.cli.bench_tables import say_result

    say_result(read_result(file), options.chosen_format(form, as_json=as_json))


@app.command("compare")
def compare(
    files: Annotated[
        list[Path], typer.Argument(metavar="FILE.json...", help="Two results or more; the first is compared with.")
    ],
    form: options.Format = None,
    as_json: options.Json = False,
) -> None:
    """Print results of several computers, or of several versions on one, side by side.

    Of each task what it takes, and that over the first file's: as it is, and as if arithmetic alone took as long there,
    which leaves out how fast the computers are. Speeds beside C leave out most of it, too.

    \b
    Examples:
      moteslam bench compare theirs.json mine.json
      moteslam bench compare before.json after.json --format markdown
    """  # noqa: D301
    from moteslam.eval.bench.comparison import common_threads, read_results
    from moteslam.eval.cli.bench_comparison import say_comparison

    form = options.chosen_format(form, as_json=as_json)
    if len(files) < 2:
        raise ConfigError(f"{len(files)} file, expected two or more to compare", file=files[0])
    results = read_results(files)
    say_comparison(files, results, common_threads(files, results), form)
