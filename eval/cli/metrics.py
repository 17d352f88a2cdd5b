"""``moteslam metrics``: what runs can be scored by."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer
from moteslam.eval.tables import aligned


def metrics(as_json: options.Json = False) -> None:
    """List the metrics: unit, what they measure, where they are defined.

    Metrics of trajectories are measured of the final and the online one and of dead reckoning, and named by it:
    final.ate. Relative errors are to be had over any length, time or number of poses: rpe_2.5m, rpe_5s,
    rpe_10frames_rotation.

    \b
    Examples:
      moteslam metrics
      moteslam metrics --json
    """  # noqa: D301
    from moteslam.eval.metrics.registry import METRICS

    found = {
        name: {
            "of": "run" if one.of_trajectory is None else "trajectory",
            "unit": one.unit,
            "better": one.better,
            "costly": one.costly,
            "meaning": one.meaning,
            "source": one.source,
        }
        for name, one in METRICS.items()
    }
    answer(found, _lines(found), as_json=as_json)


def _lines(found: dict[str, dict[str, Any]]) -> Iterator[str]:

    for title, of in (("of each trajectory", "trajectory"), ("of a run", "run")):
        rows = [("", "unit", "better", "", "")]
        for name, one in found.items():
            if one["of"] == of:
                source = one["source"] + "; costly" * one["costly"]
                rows.append((name, one["unit"], one["better"] or "", one["meaning"], source))
        yield from (title, aligned(rows), "")
