"""The best configuration that a budget of processor time allows, out of a sweep whose times were measured."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

from moteslam.errors import ConfigError, InputError
from moteslam.eval.statistics import Comparison, Population, Summary, compare
from moteslam.eval.sweep.tables import better

COST = "cpu_per_scan"
BUDGET = re.compile(r"([0-9]+(?:\.[0-9]+)?)\s*(us|ms|s)")
MILLISECONDS = {"us": 1e-3, "ms": 1.0, "s": 1e3}


@dataclass(frozen=True)
class Choice:
    """A configuration with what it costs and what it reaches.

    Attributes:
        name: of the configuration.
        cost: median processor time a scan [ms].
        value: of the metric over all of its runs.
        against: the best one of those that the budget allows, in pairs with this one; None of that itself.
    """

    name: str
    cost: float
    value: Summary
    against: Comparison | None


def parse_budget(text: str) -> float:
    """A time such as ``10ms`` in milliseconds.

    Raises:
        ConfigError: it is none.
    """
    found = BUDGET.fullmatch(text.strip())
    if found is None or not float(found[1]) > 0:
        raise ConfigError(f"{text!r}, expected a time above 0 a scan, such as 10ms", field="--budget")
    return float(found[1]) * MILLISECONDS[found[2]]


def affordable(found: Sequence[Population], budget: float, metric: str) -> list[Choice]:
    """The configurations whose median processor time a scan is within a budget [ms], the best first.

    Best is the best median of the metric over all runs, failed ones among them; the others are compared with it in
    pairs, since medians that differ by less than their seeds do say little.

    Raises:
        InputError: times were not measured, or no configuration is within the budget; the cheapest is named.
    """
    costs: dict[str, float] = {}
    for each in found:
        cost = Summary.of([value for value in each.values(COST).values() if value is not None]).median
        if cost is not None:
            costs[each.name] = cost
    if not costs:
        raise InputError("without times, expected a sweep that was made with --time", field=COST)
    within = [each for each in found if costs.get(each.name, float("inf")) <= budget]
    if not within:
        name, cost = min(costs.items(), key=lambda item: item[1])
        raise InputError(
            f"nothing costs {budget:g} ms a scan or less; the cheapest is {name}, {cost:.3g} ms", field=COST
        )

    def summary(each: Population) -> Summary:
        values = each.values(metric)
        failed = sum(value is None for value in values.values())
        return Summary.of([value for value in values.values() if value is not None], failed, better=better(metric))

    summaries = {each.name: summary(each) for each in within}
    worst = float("inf") if better(metric) == "lower" else float("-inf")
    sign = 1.0 if better(metric) == "lower" else -1.0

    def rank(each: Population) -> float:
        median = summaries[each.name].median
        return sign * (worst if median is None else median)

    ordered = sorted(within, key=rank)
    best = ordered[0]
    return [
        Choice(
            each.name,
            costs[each.name],
            summaries[each.name],
            None if each is best else compare(each.values(metric), best.values(metric), better=better(metric)),
        )
        for each in ordered
    ]
