"""What the command line says: results on stdout, notes and progress on stderr, names of files exactly as they are."""

import json
import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Any

from moteslam.errors import OutputError
from moteslam.eval.cli.interrupt import check_interrupt
from moteslam.eval.tables import literal

STDOUT = "stdout"  # What errors call it


def answer(found: Any, lines: Iterable[str], *, as_json: bool) -> None:
    """The result of a command on stdout: lines for people, or JSON, where numbers that are not finite become null."""
    if as_json:
        finite = json.loads(json.dumps(found), parse_constant=lambda _: None)
        lines = [json.dumps(finite, indent=2)]
    for line in lines:
        say(line)


def say(text: str) -> None:
    """A line of the result, on stdout."""
    with stdout_named():
        sys.stdout.write(text + "\n")


@contextmanager
def stdout_named() -> Iterator[None]:
    """An error of writing to stdout is an ``OutputError``, but a closed pipe a ``BrokenPipeError``."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputError(f"cannot be written: {error.strerror or error}", file=STDOUT) from error


def note(text: object) -> None:
    """A line about the run, on stderr: a warning or an error."""
    sys.stderr.write(f"moteslam: {literal(text)}\n")


def warn(issues: Iterable[object]) -> None:
    """A line on stderr for each issue."""
    for issue in issues:
        note(f"warning: {issue}")


@contextmanager
def progress_bar(what: str, total: float, unit: str = "") -> Iterator[Callable[[float], None]]:
    """A bar with rate and remaining time, if stderr is a terminal; what is yielded is called with how much is done.

    Without a unit of the total, such as ``scans``, it shows a percentage alone.
    """
    if not sys.stderr.isatty():
        yield lambda _done: check_interrupt()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    rate = [TextColumn("{task.fields[rate]}", markup=False)] if unit else []
    parts = (TextColumn("{task.description}", markup=False), BarColumn(), TextColumn("{task.percentage:>3.0f}%"))
    with Progress(*parts, *rate, TimeRemainingColumn(), console=Console(stderr=True), transient=True) as progress:
        task = progress.add_task(what, total=total, rate="")

        def update(done: float) -> None:
            check_interrupt()
            speed = progress.tasks[0].speed
            progress.update(task, completed=done, rate=f"{speed:.0f} {unit}/s" if speed else "")

        yield update


@contextmanager
def simulation_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar for a simulation's progress: first the drive, then the lidar."""
    with progress_bar("simulation", 2.0) as update:
        yield lambda what, share: update(share + (1.0 if what == "lidar" else 0.0))
