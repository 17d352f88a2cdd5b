"""The three schemes of resampling: unbiased, repeatable, and each with the spread that it promises."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.slam.filter.resampling import SCHEMES, Draws, generator_for, resample
from moteslam.slam.settings import resolve_config

WEIGHTS = np.array([0.02, 0.31, 0.0, 0.17, 0.5, 0.0])


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("count", [3, 6, 25])
def test_a_particle_is_drawn_in_proportion_to_its_weight(scheme: str, count: int):
    draws = 4000
    counts = np.zeros(len(WEIGHTS))
    for step in range(draws):
        parents = resample(scheme, WEIGHTS, generator_for(7, step), count)
        assert len(parents) == count
        counts += np.bincount(parents, minlength=len(WEIGHTS))
    # independent draws vary most: five of their standard deviations
    margin = 5 * np.sqrt(draws * count * WEIGHTS * (1 - WEIGHTS))
    assert (np.abs(counts - draws * count * WEIGHTS) <= margin).all()
    assert (counts[WEIGHTS == 0] == 0).all()


@pytest.mark.parametrize(("scheme", "margin"), [("systematic", 1), ("stratified", 2), ("residual", None)])
def test_no_particle_is_drawn_much_too_often_or_seldom(scheme: str, margin: int | None):
    generator = np.random.default_rng(3)
    for step in range(200):
        weights = generator.dirichlet(np.full(40, 0.3))
        parents = resample(scheme, weights, generator_for(1, step), 60)
        assert (np.diff(parents) >= 0).all()
        counts = np.bincount(parents, minlength=40)
        if margin is None:
            assert (counts >= np.floor(60 * weights)).all()
        else:
            assert (np.abs(counts - 60 * weights) < margin).all()


@pytest.mark.parametrize("scheme", SCHEMES)
def test_the_same_seed_and_step_give_the_same_parents(scheme: str):
    weights = np.random.default_rng(0).dirichlet(np.ones(200))
    one, two, other_step, other_seed = (
        resample(scheme, weights, generator_for(*key)) for key in ((4, 9), (4, 9), (4, 10), (5, 9))
    )
    np.testing.assert_array_equal(one, two)
    assert (one != other_step).any()
    assert (one != other_seed).any()


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("n", [1, 7, 49, 1000])
def test_equal_weights_keep_every_particle(scheme: str, n: int):
    np.testing.assert_array_equal(resample(scheme, np.full(n, 1 / n), generator_for(0, 0)), np.arange(n))


def test_a_scheme_that_is_none_is_refused_by_its_key():
    assert resolve_config("paper", ["resampling=residual"]).resampling == "residual"
    with pytest.raises(ConfigError, match="resampling"):
        resolve_config("paper", ["resampling=branching"])


def test_every_purpose_has_random_numbers_of_its_own():
    first = {purpose: generator_for(3, 4, purpose).random(50) for purpose in Draws}
    assert len(np.unique(np.concatenate(list(first.values())))) == 50 * len(Draws)
