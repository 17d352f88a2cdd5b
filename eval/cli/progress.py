"""A progress bar on a terminal, silence in a pipe."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from moteslam.eval.cli.interrupt import check_interrupt


class Bar:
    """One line of progress; this one shows nothing, and only looks whether the user wants to stop."""

    def update(self, done: float) -> None:
        """Show how much of the total is done."""
        check_interrupt()


class _RichBar(Bar):
    def __init__(self, progress: object, task: object) -> None:
        self._progress, self._task = progress, task

    def update(self, done: float) -> None:
        super().update(done)
        self._progress.update(self._task, completed=done)  # type: ignore[attr-defined]


@contextmanager
def progress_bar(what: str, total: float, unit: str) -> Iterator[Bar]:
    """A bar on stderr with rate and remaining time, if stderr is a terminal.

    Args:
        what: is being done.
        total: how much there is to do.
        unit: of the total, ``scans``; empty shows a percentage alone.
    """
    if not sys.stderr.isatty():
        yield Bar()
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, ProgressColumn, Task, TextColumn, TimeRemainingColumn
    from rich.text import Text

    class Rate(ProgressColumn):
        def render(self, task: Task) -> Text:
            speed = task.finished_speed or task.speed
            return Text("" if speed is None or not unit else f"{speed:.0f} {unit}/s")

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TextColumn("{task.percentage:>3.0f}%"),
        Rate(),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as progress:
        yield _RichBar(progress, progress.add_task(what, total=total))


@contextmanager
def working(what: str) -> Iterator[None]:
    """A line on stderr while something is done that has no measure of progress, if stderr is a terminal."""
    if not sys.stderr.isatty():
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(what):
        yield


@contextmanager
def simulation_bar() -> Iterator[Callable[[str, float], None]]:
    """A bar for a simulation's progress: first the drive, then the lidar."""
    with progress_bar("simulation", 2.0, "") as bar:
        yield lambda what, share: bar.update(share + (1.0 if what == "lidar" else 0.0))
