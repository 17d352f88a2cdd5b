"""Medians with their intervals, shares with theirs, and configurations in pairs."""

from __future__ import annotations

from math import inf

import numpy as np
import pytest

from moteslam.eval.statistics import Proportion, Summary, compare


def test_a_summary_of_some_runs() -> None:
    summary = Summary.of([3.0, 1.0, 2.0, None, 5.0, 4.0])
    assert (summary.runs, summary.failed, summary.absent) == (6, 0, 1)
    assert (summary.median, summary.low_quartile, summary.high_quartile) == (3.0, 2.0, 4.0)
    assert (summary.best, summary.worst) == (1.0, 5.0)
    assert (summary.low, summary.high) == (None, None)  # five values
    six = Summary.of([3.0, 1.0, 2.0, 6.0, 5.0, 4.0])
    assert six.low is not None
    assert six.high is not None
    assert 1.0 <= six.low <= 3.5 <= six.high <= 6.0
    assert Summary.of([3.0, 1.0, 2.0, 6.0, 5.0, 4.0]) == six
    upwards = Summary.of([1.0, 2.0], better="higher")
    assert (upwards.best, upwards.worst) == (2.0, 1.0)


def test_failed_runs_are_the_worst_and_never_averaged() -> None:
    values = [0.1, 0.2, 0.3]
    for failed, median in ((0, 0.2), (1, 0.25), (2, 0.3), (3, inf), (4, inf)):
        summary = Summary.of(values, failed)
        assert summary.median == pytest.approx(median)
        assert (summary.runs, summary.failed, summary.best) == (3 + failed, failed, 0.1)
    assert Summary.of(values, 2, better="higher").median == 0.1
    assert Summary.of([]).median is None
    assert Summary.of([None]).median is None


def test_the_interval_of_the_median_holds_it_as_often_as_it_says() -> None:
    rng = np.random.default_rng(4)
    inside = 0
    for _ in range(300):
        summary = Summary.of(rng.lognormal(size=25).tolist())
        assert summary.low is not None
        assert summary.high is not None
        inside += summary.low <= 1.0 <= summary.high
    assert 0.91 <= inside / 300 <= 0.985


@pytest.mark.parametrize(
    ("count", "total", "low", "high"), [(0, 10, 0.0, 0.2775), (10, 10, 0.7225, 1.0), (81, 263, 0.2553, 0.3662)]
)
def test_wilsons_interval(count: int, total: int, low: float, high: float) -> None:
    """The last one is the example of Newcombe (1998), table I."""
    share = Proportion(count, total)
    assert share.interval == pytest.approx((low, high), abs=1e-4)
    assert share.as_dict() == {
        "share": count / total, "low": share.interval[0], "high": share.interval[1], "count": count, "total": total
    }  # fmt: skip


def test_pairs_leave_out_what_makes_a_seed_harder() -> None:
    """Each seed is as different as the seeds are; the second configuration is a little better on each."""
    rng = np.random.default_rng(3)
    seeds = {seed: float(value) for seed, value in enumerate(rng.lognormal(size=40))}
    better = {seed: 0.95 * value for seed, value in seeds.items()}
    found = compare(seeds, better)
    assert (found.pairs, found.wins, found.losses, found.ties) == (40, 40, 0, 0)
    assert found.p < 1e-9
    assert found.high is not None
    assert found.high < 0
    assert compare(seeds, better, better="higher").losses == 40
    same = compare(seeds, seeds)
    assert (same.wins, same.ties, same.p, same.median) == (0, 40, 1.0, 0.0)


def test_failed_runs_lose() -> None:
    first = {0: 0.1, 1: 0.1, 2: None, 3: None, 4: 0.1}
    second = {0: None, 1: 0.2, 2: 0.3, 3: None, 9: 0.1}
    found = compare(first, second)
    assert (found.pairs, found.wins, found.losses, found.ties, found.apart) == (4, 1, 2, 1, 2)
    assert found.failed == (2, 2)
    assert found.median == pytest.approx(0.1)
    lost = compare({0: 0.1, 1: 0.1}, {0: None, 1: None})
    assert lost.median == inf
    nothing = compare({}, {})
    assert (nothing.pairs, nothing.median, nothing.p) == (0, None, 1.0)


def test_the_sign_test_is_that_of_a_fair_coin() -> None:
    first = dict.fromkeys(range(10), 1.0)
    second = {k: 0.5 if k < 9 else 2.0 for k in range(10)}
    assert compare(first, second).p == pytest.approx(2 * 11 / 1024)


def test_rounding_is_no_difference() -> None:
    """Of 1e-17 m neither is better."""
    found = compare({0: 0.1, 1: 0.1, 2: 0.1}, {0: 0.1 + 1e-16, 1: 0.1 - 1e-16, 2: 0.0999})
    assert (found.wins, found.losses, found.ties) == (1, 0, 2)
