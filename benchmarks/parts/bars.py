"""What is asked of a run's figures, and whether it holds."""

from __future__ import annotations

import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any, Literal

NO_FIGURES = ("run", "seed", "error", "load", "scans", "updates", "seconds")
"""What a row holds beside its figures; counts that are the same for all seeds begin with ``n_``."""


@dataclass(frozen=True)
class Bar:
    """What is asked of one figure.

    Attributes:
        figure: the key of the rows.
        over: the seeds: ``worst`` or ``median``.
        limit: the largest value allowed; the smallest, where ``least``.
        strict: the limit itself is not allowed.
        least: more is better, and the worst seed is the one with the smallest value.
    """

    figure: str
    over: Literal["worst", "median"]
    limit: float
    strict: bool = False
    least: bool = False

    def holds(self, value: float) -> bool:
        """Whether a value is allowed; one that is not a number is not."""
        value, limit = (-value, -self.limit) if self.least else (value, self.limit)
        return value < limit if self.strict else value <= limit

    def __str__(self) -> str:
        sign = (">" if self.least else "<") + ("" if self.strict else "=")
        return f"{self.over} {sign} {self.limit:g}"


def summarise(
    rows: Sequence[Mapping[str, Any]], bars: Sequence[Bar], *, more_is_better: Collection[str] = ()
) -> dict[str, Any]:
    """Median and worst of every figure of a run's rows, and its bars with what they came to.

    A seed that crashed has an ``error`` and no figures: then no bar holds. A figure that some rows do not have is that
    of the others, with their number.

    Args:
        rows: of the seeds of one run.
        bars: of that run.
        more_is_better: figures without a bar whose worst value is the smallest one.
    """
    good = [row for row in rows if "error" not in row]
    numbers = list(dict.fromkeys(key for row in good for key, value in row.items() if isinstance(value, (int, float))))
    keys = [key for key in numbers if key not in NO_FIGURES and not key.startswith("n_")]
    smallest = {*more_is_better, *(bar.figure for bar in bars if bar.least)}
    figures = {
        key: {
            "median": statistics.median(values),
            "worst": (min if key in smallest else max)(values),
            **({"seeds": len(values)} if len(values) < len(good) else {}),
        }
        for key in keys
        if (values := [row[key] for row in good if key in row])
    }
    judged = []
    for bar in bars:
        value = figures.get(bar.figure, {}).get(bar.over)
        everywhere = all(bar.figure in row for row in rows)
        holds = value is not None and everywhere and bar.holds(value)
        judged.append({**asdict(bar), "text": str(bar), "value": value, "holds": holds})
    counts = {key: good[0][key] for key in numbers if key.startswith("n_")}
    return {"seeds": len(rows), "crashed": len(rows) - len(good), **counts, "figures": figures, "bars": judged}


def summary_lines(summaries: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """The summaries as a table: a line a figure, one more for each further bar of it."""
    lines: list[tuple[str, ...]] = [("run", "seeds", "figure", "median", "worst", "bar", "holds")]
    for run, summary in summaries.items():
        seeds = str(summary["seeds"]) + (f", {summary['crashed']} crashed" if summary["crashed"] else "")
        if not summary["figures"]:
            lines.append((run, seeds, "-", "-", "-", "-", "no"))
        for figure, value in summary["figures"].items():
            row = (run, seeds, figure, f"{value['median']:.4f}", f"{value['worst']:.4f}")
            bars = [bar for bar in summary["bars"] if bar["figure"] == figure]
            lines.append((*row, *_verdict(bars[0] if bars else None)))
            lines += [("", "", "", "", "", *_verdict(bar)) for bar in bars[1:]]
    return lines


def _verdict(bar: Mapping[str, Any] | None) -> tuple[str, str]:
    return ("", "") if bar is None else (bar["text"], "yes" if bar["holds"] else "NO")
