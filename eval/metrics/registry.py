"""The metrics by name, each a number with a unit: the bundled ones, and those of other packages.

Other packages bring theirs as entry points ``moteslam.metrics``. A metric that cannot be had of a run is absent with
its reason, never zero.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from math import isfinite
from typing import Any, get_args

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.evidence import Evidence, Track
from moteslam.eval.metrics.rpe import Unit
from moteslam.eval.statistics.summary import Better
from moteslam.plugins import Plugins


@dataclass(frozen=True)
class Metric:
    """A metric: of each trajectory of a run, or of the run.

    Attributes:
        unit: of the value: ``m``, ``deg``, ...; empty for shares and counts.
        meaning: what it measures, one sentence.
        source: where its definition comes from.
        of_trajectory, of_run: computes it; one of the two. ``InputError`` where it cannot be had.
        better: which values are better; None where neither is.
        costly: takes seconds: measured when asked for by name.
    """

    unit: str
    meaning: str
    source: str
    of_trajectory: Callable[[Track], float | None] | None = None
    of_run: Callable[[Evidence], float | None] | None = None
    better: Better | None = "lower"
    costly: bool = False

    def __post_init__(self) -> None:
        if (self.of_trajectory is None) == (self.of_run is None):
            raise ConfigError("expected either of_trajectory or of_run", field="metric")


@dataclass(frozen=True)
class Value:
    """What a metric came to: a finite number, or why there is none."""

    number: float | None
    unit: str
    reason: str = ""

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        return {"value": self.number, "unit": self.unit} if self.number is not None else {"absent": self.reason}


COSTS = ("cpu_per_scan", "wall_per_scan", "wall_per_scan_median", "wall_per_scan_99", "real_time_factor", "memory")
"""Names of the metrics that differ from run to run."""
BUNDLED = (
    *("ate", "ate_median", "ate_max", "ate_scaled", "ate_from_start", "heading"),
    *("rpe_1m", "rpe_1m_rotation", "rpe_10m", "rpe_10m_rotation", "rpe_1s", "rpe_1s_rotation"),
    *("drift", "drift_rotation", "loop_closing", "loop_closing_rotation", "relations", "relations_rotation"),
    *("residual", "map_cells", "map_cells_per_metre", "map_near", "map_far", "map_thickness", "map_twice"),
    *("map_precision", "map_recall", "map_f1", "map_distance", "map_free_iou", "map_known"),
    *("nees", "nees_within_95", "nees_from_start", "nees_end", "within_spread", "effective_particles"),
    *("lost_precision", "lost_recall", "loops_precision", "loops_recall", "loops_false"),
    *COSTS,
)
"""Names of the metrics of this package, in the order in which they are listed."""

METRICS: Plugins[Metric] = Plugins(
    "moteslam.metrics",
    Metric,
    bundled={name: f"moteslam.eval.metrics.catalogue:{name.upper()}" for name in BUNDLED},
)
"""By name."""

RPE = re.compile(r"rpe_(?P<delta>[0-9]+(?:\.[0-9]+)?)(?P<unit>m|s|frames)(?P<rotation>_rotation)?")
"""Names of relative errors over any length, time or number of poses."""


def metric(name: str) -> Metric:
    """The metric of that name: one of ``METRICS``, or a relative error as ``rpe_2.5m`` or ``rpe_10frames_rotation``.

    Args:
        name: with or without a trajectory, ``final.ate`` or ``ate``.

    Raises:
        ConfigError: there is none.
    """
    short = split(name)[1]
    if short not in METRICS.names() and (found := RPE.fullmatch(short)):
        delta, unit = float(found["delta"]), next(unit for unit in get_args(Unit) if unit == found["unit"])
        if not delta > 0 or (unit == "frames" and not delta.is_integer()):
            expected = "a whole number of poses from 1 on" if unit == "frames" else "a length above 0"
            raise ConfigError(f"{name!r}, expected {expected}", field="metrics")
        from moteslam.eval.metrics.catalogue import relative_error

        return relative_error(delta, unit, rotation=found["rotation"] is not None)
    if short not in METRICS.names():
        raise ConfigError(f"{name!r}, expected one of {', '.join(METRICS.names())}", field="metrics")
    return METRICS[short]


def measure(evidence: Evidence, names: Iterable[str] | None = None) -> dict[str, Value]:
    """Measure a run.

    Args:
        evidence: what is known of it.
        names: of the metrics, by default all that are not costly. Those of trajectories are measured of each, and
            named by it: ``final.ate``; such a name measures it of that one alone.

    Returns:
        the values by name, as ``final.ate`` and ``map_f1``, in the order of the names.

    Raises:
        ConfigError: a name that is no metric's.
    """
    values: dict[str, Value] = {}
    for name, one in chosen(names).items():
        track, short = split(name)
        if one.of_run is not None:
            if track:
                raise ConfigError(f"{name!r}, expected {short!r}: a metric of the run", field="metrics")
            values[name] = _value(short, one, partial(one.of_run, evidence))
            continue
        for which in [track] if track else list(evidence.trajectories):
            values[f"{which}.{short}"] = _value(short, one, partial(_of_track, one, evidence, which))
    return values


def _of_track(one: Metric, evidence: Evidence, which: str) -> float | None:
    assert one.of_trajectory is not None  # or it is of the run
    return one.of_trajectory(evidence.track(which))


def chosen(names: Iterable[str] | None) -> Mapping[str, Metric]:
    """The metrics of these names, by default all that are not costly; see ``measure``."""
    if names is None:
        return {name: one for name, one in METRICS.items() if not one.costly}
    return {name: metric(name) for name in names}


def split(name: str) -> tuple[str, str]:
    """The trajectory and the metric of a name such as ``final.rpe_2.5m``; no trajectory in ``rpe_2.5m``."""
    if RPE.fullmatch(name):
        return "", name
    track, dot, short = name.partition(".")
    return (track, short) if dot else ("", name)


def _value(name: str, one: Metric, compute: Callable[[], float | None]) -> Value:
    try:
        number = compute()
        finite = number is not None and isfinite(number)
    except InputError as error:
        return Value(None, one.unit, error.problem)
    except Exception as error:  # a plug-in's fault must not cost the run
        if METRICS.is_bundled(name) or RPE.fullmatch(name):
            raise
        problem = f"{type(error).__name__}: {error}"
        METRICS.warn(name, problem)
        return Value(None, one.unit, problem)
    if number is None:
        return Value(None, one.unit, "nothing to measure")
    if not finite:
        return Value(None, one.unit, "not a finite number")
    return Value(float(number), one.unit)
