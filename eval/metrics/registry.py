"""The metrics by name, the bundled ones and those of other packages, and the values of a run.

Other packages bring theirs as entry points ``moteslam.metrics``. A metric that cannot be had of a run is absent with
its reason, never zero.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from math import isfinite
from typing import Any, get_args

from moteslam.errors import ConfigError, InputError
from moteslam.eval.metrics.catalogue import BUNDLED, Metric, relative_error
from moteslam.eval.metrics.evidence import Evidence
from moteslam.eval.metrics.rpe import Unit
from moteslam.plugins import Plugins

METRICS: Plugins[Metric] = Plugins("moteslam.metrics", Metric, bundled=BUNDLED)
"""By name."""

RPE = re.compile(r"rpe_(?P<delta>[0-9]+(?:\.[0-9]+)?)(?P<unit>m|s|frames)(?P<rotation>_rotation)?")
"""Names of relative errors over any length, time or number of poses."""


@dataclass(frozen=True)
class Value:
    """The value of a metric: a finite number, or the reason why there is none.

    ``more`` has further figures of the same errors, such as their ``median``, ``max`` and ``count``.
    """

    number: float | None
    unit: str
    reason: str = ""
    more: Mapping[str, Any] = field(default_factory=dict)

    def as_dict(self) -> dict[str, Any]:
        """Fit for JSON."""
        if self.number is None:
            return {"absent": self.reason}
        return {"value": self.number, "unit": self.unit, **self.more}


def metric(name: str) -> Metric:
    """The metric of that name: one of ``METRICS``, or a relative error as ``rpe_2.5m`` or ``rpe_10frames_rotation``.

    With or without a trajectory, ``final.ate`` or ``ate``; ``ConfigError`` if there is none.
    """
    short = split(name)[1]
    if short in METRICS.names():
        return METRICS[short]
    found = RPE.fullmatch(short)
    if found is None:
        raise ConfigError(f"{name!r}, expected one of {', '.join(METRICS.names())}", field="metrics")
    delta, unit = float(found["delta"]), next(unit for unit in get_args(Unit) if unit == found["unit"])
    if not delta > 0 or (unit == "frames" and not delta.is_integer()):
        expected = "a whole number of poses from 1 on" if unit == "frames" else "a length above 0"
        raise ConfigError(f"{name!r}, expected {expected}", field="metrics")
    return relative_error(delta, unit, rotation=found["rotation"] is not None)


def measure(evidence: Evidence, names: Iterable[str] | None = None) -> dict[str, Value]:
    """The values of a run by name, as ``final.ate`` and ``map_f1``, in the order of the names.

    By default all that are not costly. Metrics of trajectories are measured of each, and named by it: ``final.ate``;
    such a name measures it of that one alone. ``ConfigError``: a name that is no metric's.
    """
    values: dict[str, Value] = {}
    for name, one in chosen(names).items():
        track, short = split(name)
        if track and one.of_run is not None:
            raise ConfigError(f"{name!r}, expected {short!r}: a metric of the run", field="metrics")
        for which in [""] if one.of_run is not None else [track] if track else list(evidence.trajectories):
            values[f"{which}.{short}" if which else name] = _value(short, one, evidence, which)
    return values


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


def _value(name: str, one: Metric, evidence: Evidence, track: str) -> Value:
    """A metric of a run, or of its trajectory of that name."""
    try:
        if one.of_trajectory is not None:
            found = one.of_trajectory(evidence.track(track))
        else:
            assert one.of_run is not None
            found = one.of_run(evidence)
        number, more = found if isinstance(found, tuple) else (found, {})
        if number is None or not isfinite(number):
            return Value(None, one.unit, "nothing to measure" if number is None else "not a finite number")
        return Value(float(number), one.unit, more=more)
    except InputError as error:
        return Value(None, one.unit, error.problem)
    except Exception as error:  # a plug-in's fault must not cost the run
        if name in BUNDLED or RPE.fullmatch(name):
            raise
        problem = f"{type(error).__name__}: {error}"
        METRICS.warn(name, problem)
        return Value(None, one.unit, problem)
