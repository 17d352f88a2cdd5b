"""What the benchmarks share: options, processes, rows in a CSV file, and their summary beside what is asked of them."""

import argparse
import csv
import json
import math
import os
import platform
import re
import statistics
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from importlib.metadata import version
from multiprocessing import get_context
from pathlib import Path
from typing import Any, Literal

from moteslam.errors import MoteslamError
from moteslam.eval.tables import aligned

Row = dict[str, Any]
"""Of one run: ``run`` (rows of one are summarised together), ``seed``, then figures; or ``error``, where it crashed."""
Case = tuple[Row, tuple[Any, ...]]  # How a row begins, and the arguments that its figures are measured with

STAMP = ("date", "hardware", "load", "versions")


@dataclass(frozen=True)
class Bar:
    """What is asked of one figure."""

    figure: str
    over: Literal["worst", "median"]  # of the seeds
    limit: float  # the largest value allowed; the smallest, where ``least``
    least: bool = False  # more is better, and the worst seed is the one with the smallest value

    def holds(self, value: float) -> bool:
        """Whether a value is allowed; NaN is not."""
        return value >= self.limit if self.least else value <= self.limit

    def __str__(self) -> str:
        return f"{self.over} {'>=' if self.least else '<='} {self.limit:g}"


Bars = Mapping[str, Sequence[Bar]]  # By ``run``


def seeds(text: str) -> range:
    """``5`` is the seeds 0 to 4, ``5-9`` those from 5 to 9."""
    match = re.fullmatch(r"(?:(\d+)-)?(\d+)", text)
    first, last = match.groups() if match else (None, "0")
    asked = range(int(last)) if first is None else range(int(first), int(last) + 1)
    if not asked:
        raise argparse.ArgumentTypeError(f"{text!r}, expected a number of seeds, or the first and the last: 10-19")
    return asked


def count(text: str) -> int:
    if not text.isdecimal() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r}, expected 1 or more")
    return int(text)


def factor(text: str) -> float:
    with suppress(ValueError):
        if 0 <= float(text) < math.inf:
            return float(text)
    raise argparse.ArgumentTypeError(f"{text!r}, expected a number from 0")


def result_file(text: str) -> Path:
    """A file that can be written, checked before anything is measured; the folders above it are made."""
    path = Path(text)
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("a", encoding="utf-8").close()
    except OSError as error:
        raise argparse.ArgumentTypeError(f"{text!r}: {error.strerror}, expected a file to write to") from error
    return path


def arguments(doc: str | None, *, settings: bool = False) -> argparse.ArgumentParser:
    """A parser with the options of every benchmark, and ``--set`` of those whose SLAM takes settings."""
    parser = argparse.ArgumentParser(description=doc, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=seeds, metavar="N", help="from 0, in place of the usual ones; or 10-19")
    parser.add_argument("--workers", type=count, default=1, help="processes [1]")
    parser.add_argument("--out", type=result_file, metavar="FILE.csv", help="a row a run, written anew after each")
    if settings:
        parser.add_argument("--set", action="append", default=[], metavar="KEY=VALUE", dest="settings", help="of SLAM")
    return parser


def parsed(parser: argparse.ArgumentParser) -> argparse.Namespace:
    """The options, whose settings SLAM takes."""
    from moteslam.slam.config import resolve_config

    options = parser.parse_args()
    try:
        resolve_config("default", options.settings)
    except MoteslamError as error:
        parser.error(str(error))
    return options


def expect_known(parser: argparse.ArgumentParser, option: str, names: Iterable[str], known: Iterable[str]) -> None:
    """Leave with a line about a name that is not known."""
    known = list(known)
    for name in names:
        if name not in known:
            parser.error(f"{option}: {name!r}, expected of {', '.join(known)}")


def stamp() -> Row:
    """When and where: date, hardware, how busy it is, and versions."""
    return {
        "date": date.today().isoformat(),
        "hardware": f"{processor()}, {os.cpu_count()} cores",
        "load": os.getloadavg()[0],
        "versions": " ".join(f"{name} {version(name)}" for name in ("moteslam", "taichi", "numpy", "pymunk")),
    }


def processor() -> str:
    """The processor's name, where the system gives it; else its kind."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()}, {platform.machine()}"
    return platform.machine()


def memory(field: Literal["VmRSS", "VmHWM", "VmData"]) -> float:
    """Of this process [MB]: in use now, the most so far (``ru_maxrss`` begins with its parent's), or of data."""
    lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
    return 1024e-6 * next(int(line.split()[1]) for line in lines if line.startswith(field))


def benchmark(
    measure: Callable[..., Row],
    cases: Sequence[Case],
    options: argparse.Namespace,
    *,
    bars: Bars | None = None,
    fresh: bool = False,
    summary: Callable[[list[Row]], str] | None = None,
) -> list[Row]:
    """Measure all cases, print and save a row after each, and at the end the summary.

    Args:
        measure: gives the figures of a case; a function of a module, called in a process of a pool.
        cases: in their order.
        options: of ``arguments``.
        bars: what is asked; without them nothing is.
        fresh: each case has a process of its own.
        summary: prints another one of the rows.

    Returns:
        the rows; ``status`` gives the exit code.
    """
    rows: list[Row] = []
    context = get_context("spawn")  # Taichi cannot fork
    with ProcessPoolExecutor(options.workers, mp_context=context, max_tasks_per_child=1 if fresh else None) as pool:
        for about, job in [(about, pool.submit(_attempt, measure, given)) for about, given in cases]:
            rows.append({**about, **job.result()})
            print(*_shown(rows[-1]), sep="  ", flush=True)
            write_rows(options.out, rows)
    print()
    print(aligned(summary_lines(rows, bars or {})) if summary is None else summary(rows))
    return rows


def _attempt(measure: Callable[..., Row], given: tuple[Any, ...]) -> Row:
    """The figures and where they are from; of a crash its ``error``, no reason to lose other rows."""
    about = stamp()
    try:
        return {**measure(*given), **about}
    except Exception as error:
        return {"error": str(error) if isinstance(error, MoteslamError) else repr(error), **about}


def _shown(row: Row) -> Iterator[str]:
    for key, value in row.items():
        if key not in STAMP and value not in (None, "") and not isinstance(value, list):
            yield f"{key} {value:.4g}" if isinstance(value, float) else f"{key} {value}"


def write_rows(path: Path | None, rows: Sequence[Row]) -> None:
    """A CSV file of all rows; values that are no text are JSON."""
    if path is None:
        return
    keys = list(dict.fromkeys(key for row in rows for key in row))
    with path.open("w", encoding="utf-8", newline="") as file:
        writer = csv.DictWriter(file, keys)
        writer.writeheader()
        for row in rows:
            writer.writerow({key: v if isinstance(v, str) else json.dumps(v) for key, v in row.items()})


def by_run(rows: Iterable[Row]) -> dict[str, list[Row]]:
    groups: dict[str, list[Row]] = {}
    for row in rows:
        groups.setdefault(row["run"], []).append(row)
    return groups


def figures(rows: Sequence[Row], bars: Sequence[Bar] = ()) -> dict[str, tuple[float, float, int]]:
    """Median and worst of every figure of a run, and of how many seeds; of what holds or not, the share that does."""
    least = {bar.figure for bar in bars if bar.least}
    values: dict[str, list[float]] = {}
    for row in rows:
        for key, value in row.items():
            if isinstance(value, (int, float)) and key not in ("seed", "load"):
                values.setdefault(key, []).append(value)
    found = {}
    for key, some in values.items():
        if isinstance(some[0], bool):
            share = sum(some) / len(rows)
            found[key] = share, share, len(some)
        else:
            found[key] = statistics.median(some), (min if key in least else max)(some), len(some)
    return found


def verdicts(rows: Sequence[Row], bars: Sequence[Bar]) -> Iterator[tuple[Bar, bool]]:
    """Whether each bar of a run holds; none does where a seed crashed or lacks the figure."""
    found = figures(rows, bars)
    for bar in bars:
        median, worst, number = found.get(bar.figure, (math.nan, math.nan, 0))
        yield bar, number == len(rows) and bar.holds(median if bar.over == "median" else worst)


def summary_lines(rows: Sequence[Row], bars: Bars) -> list[tuple[str, ...]]:
    """A table: a line a figure, one more for each further bar of it."""
    lines: list[tuple[str, ...]] = [("run", "seeds", "figure", "median", "worst", "bar", "holds")]
    for run, mine in by_run(rows).items():
        asked = bars.get(run, ())
        crashed = sum("error" in row for row in mine)
        seeds = f"{len(mine)}, {crashed} crashed" if crashed else str(len(mine))
        judged = list(verdicts(mine, asked))
        for figure, (median, worst, _) in figures(mine, asked).items():
            said = [(str(bar), "yes" if holds else "NO") for bar, holds in judged if bar.figure == figure]
            lines += [
                (run, seeds, figure, f"{median:.4f}", f"{worst:.4f}", *each) if k == 0 else ("",) * 5 + each
                for k, each in enumerate(said or [("", "")])
            ]
        if crashed == len(mine):
            lines.append((run, seeds, "-", "-", "-", "-", "no"))
    return lines


def draw_reliability(
    path: Path,
    groups: Mapping[str, Sequence[Row]],
    keys: tuple[str, str, str],
    labels: tuple[str, str],
    *,
    intervals: bool = False,
) -> None:
    """The reliability diagram of some rows each, said against true; the larger a mark, the more scans.

    Args:
        path: of the PNG.
        groups: by the name in the legend.
        keys: of each bin's scans, of the sum of what was said of them, and of how many it was true.
        labels: of both axes.
        intervals: draw those of 95 %; the bins are counts.
    """
    import matplotlib as mpl

    mpl.use("Agg")
    import numpy as np
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6, 5), constrained_layout=True)
    axes.plot((0, 1), (0, 1), color="0.6", label="said is true")
    for k, ((name, rows), marker) in enumerate(zip(groups.items(), "osD^vP*X", strict=False)):
        scans, said, true = (np.sum([row[key] for row in rows], axis=0) for key in keys)
        some = scans > 0
        n, x, y = scans[some], said[some] / scans[some], true[some] / scans[some]
        if intervals:
            middle = (true[some] + 2) / (n + 4)  # Agresti and Coull 1998
            half = 2 * np.sqrt(middle * (1 - middle) / (n + 4))
            bars = np.maximum((y - middle + half, middle + half - y), 0)
            axes.errorbar(x, y, bars, color=f"C{k}", linewidth=1)
        look: dict[str, Any] = {"facecolors": "none", "edgecolors": f"C{k}", "linewidths": 1.5, "marker": marker}
        axes.scatter(x, y, 30 + 200 * n / scans.sum(), label=name, **look)
    axes.set(ylim=(-0.03, 1.03), xlabel=labels[0], ylabel=labels[1])
    axes.legend(loc="lower right", fontsize="small", markerscale=0.5)
    figure.savefig(path, dpi=150)


def status(rows: Sequence[Row], bars: Bars | None = None) -> int:
    """The exit code: 1 where a run crashed or a bar does not hold."""
    groups = by_run(rows)
    held = all(
        holds for run, asked in (bars or {}).items() if run in groups for _, holds in verdicts(groups[run], asked)
    )
    return 0 if held and not any("error" in row for row in rows) else 1
