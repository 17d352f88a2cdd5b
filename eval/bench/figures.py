"""The figures of a result: spreads of many turns, ratios of what was taken in turns, and what makes them doubtful."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from statistics import median

import numpy as np

from moteslam.eval.bench.contest import OURS, C
from moteslam.eval.bench.document import BenchResult, Figure, Ratio, Spread
from moteslam.eval.bench.timing import Turns

BUSY = 0.2
"""Processors that other programs keep busy before the start, from which on the machine counts as busy."""
UNSTEADY = 0.1
"""Rounds that differ by a larger share of their median, a tenth, are unsteady."""
SHARED = 0.7
"""Threads that gain less than this share of their number in plain arithmetic share processors, or did not have them."""

TICK = 1e-12
"""No time is shorter [s], however coarse the clock."""


def figure(rounds: Sequence[Turns]) -> Figure:
    """What a unit takes, of the turns of each process."""
    walls, processors = ([[turn[k] for turn in turns] for turns in rounds] for k in (0, 1))
    return Figure(wall=spread(walls), processor=spread(processors))


def spread(rounds: Sequence[Sequence[float]]) -> Spread:
    """Of numbers of several rounds: the median of the rounds' medians, quartiles and bounds of all."""
    above = [[max(value, TICK) for value in values] for values in rounds]
    medians = tuple(float(median(values)) for values in above)
    every = [value for values in above for value in values]
    low, high = (float(value) for value in np.quantile(every, (0.25, 0.75)))
    return Spread(
        median=median(medians), low_quartile=low, high_quartile=high, least=min(every), most=max(every), rounds=medians
    )


def shown(figure: Figure, threads: int) -> Spread:
    """The times that ratios are taken of: on one thread processor time, which other programs disturb less."""
    return figure.processor if threads == 1 else figure.wall


def time_of(result: BenchResult, name: str, threads: int, contender: str = "") -> float | None:
    """What a unit of a task takes [s]: of ours, or of C where it is alone; None where it was not measured."""
    task = result.tasks.get(name)
    figures = {} if task is None else task.times.get(str(threads), {})
    found = figures.get(contender) if contender else figures.get(OURS, figures.get(C))
    return None if found is None else shown(found, threads).median


def speeds(times: Mapping[str, Mapping[str, Figure]]) -> dict[str, Ratio]:
    """By number of threads the time of C over ours, round by round."""
    found = {}
    for threads, figures in times.items():
        if OURS in figures and C in figures:
            ours, theirs = (shown(figures[name], int(threads)) for name in (OURS, C))
            found[threads] = _ratio(theirs.rounds, ours.rounds)
    return found


def gains(times: Mapping[str, Mapping[str, Figure]]) -> dict[str, Ratio]:
    """By number of threads the time by the clock on the least number over that on it; of C where that is alone."""
    if not times:
        return {}
    base = min(times, key=int)
    name = OURS if OURS in times[base] else C
    return {
        threads: _ratio(times[base][name].wall.rounds, figures[name].wall.rounds)
        for threads, figures in times.items()
        if threads != base and name in figures
    }


def _ratio(over: Sequence[float], under: Sequence[float]) -> Ratio:
    ratios = [a / b for a, b in zip(over, under, strict=True)]
    return Ratio(median=median(ratios), least=min(ratios), most=max(ratios))


def doubts(result: BenchResult) -> list[str]:
    """What makes the times of a result doubtful, a line each."""
    found = []
    if result.load is not None and result.load > BUSY:
        found.append(f"other programs kept {result.load:.1f} processors busy before the start: times may be too long")
    arithmetic = result.tasks.get("arithmetic")
    for threads, gain in ({} if arithmetic is None else arithmetic.gain).items():
        if gain.median < SHARED * int(threads) / min(result.threads):
            words = f"{threads} threads do plain arithmetic {gain.median:.2f} times as fast as {min(result.threads)}"
            found.append(f"{words}: other programs had the processors, or these are parts of one")
    unsteady = [
        name
        for name, task in result.tasks.items()
        if any(
            max(times.rounds) - min(times.rounds) > UNSTEADY * times.median
            for threads, figures in task.times.items()
            for times in (shown(one, int(threads)) for one in figures.values())
        )
    ]
    if unsteady:
        words = f"rounds differ by more than a tenth in {', '.join(unsteady)}"
        found.append(f"{words}: measure again while nothing else runs")
    return found
