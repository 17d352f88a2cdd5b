"""``moteslam metrics``: what runs can be scored by."""

from __future__ import annotations

from moteslam.eval.cli import options
from moteslam.eval.cli.text import say, say_json, table


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

    if as_json:
        say_json(
            {
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
        )
        return
    for title, wanted in (("of each trajectory", True), ("of a run", False)):
        rows = [("", "unit", "better", "", "")]
        for name, one in METRICS.items():
            if (one.of_trajectory is not None) == wanted:
                rows.append((name, one.unit, one.better or "", one.meaning, one.source + "; costly" * one.costly))
        say(title)
        say(table(rows))
        say("")
