"""When scans stop to fit the map, and when that is taken for a robot that is lost."""

from __future__ import annotations

import numpy as np

from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.filter.misfit import DOUBTFUL_DROP, LEAST_SPREAD, LOST_DROP
from moteslam.slam.tsdf.doubt import LEAST_SCANS, PROBATION, Doubt

SURE, DOUBTFUL, LOST = LocalisationState
LOW, STILL_LOW = 1.0 - 1.1 * LOST_DROP * LEAST_SPREAD, 1.0 - 1.1 * DOUBTFUL_DROP * LEAST_SPREAD


def states(*scores: float | None, driven: float = 0.25, calm: int = 40) -> list[LocalisationState]:
    doubt, found = Doubt(), []
    for score in [*([1.0] * calm), *scores]:
        doubt.look(driven, score)
        found.append(doubt.state)
    assert found[:calm] == [SURE] * calm
    return found[calm:]


def test_a_robot_is_lost_when_nothing_has_fitted_for_a_metre():
    assert states(LOW, *[STILL_LOW] * 5) == [DOUBTFUL] * 4 + [LOST] * 2
    assert round(PROBATION / 0.25) == 4


def test_few_scans_do_not_decide():
    assert states(LOW, *[STILL_LOW] * 3, driven=5.0) == [DOUBTFUL] * (LEAST_SCANS - 1) + [LOST] * 2


def test_a_scan_that_fits_again_ends_the_doubt_and_what_did_not_fit_is_not_usual():
    found = states(*[LOW, STILL_LOW, 1.0] * 5)
    assert found == [DOUBTFUL, DOUBTFUL, SURE] * 5


def test_what_changes_little_by_little_is_no_misfit():
    assert set(states(*np.arange(1.0, 0.2, -0.05).repeat(2))) == {SURE}


def test_a_small_drop_alone_is_none():
    assert set(states(*[STILL_LOW] * 3)) == {SURE}


def test_scans_that_are_not_matched_say_nothing():
    assert states(LOW, None, None, None, None, 1.0) == [DOUBTFUL] * 5 + [SURE]


def test_a_place_that_is_new_is_no_misfit():
    doubt = Doubt()
    for _ in range(40):
        doubt.look(0.25, 1.0)
    found = []
    for score in (LOW, *[STILL_LOW] * 4):
        doubt.look(0.25, score, known=0.4)
        found.append(doubt.state)
    assert found == [*[DOUBTFUL] * 4, SURE]


def test_who_is_lost_stays_so():
    assert states(LOW, *[STILL_LOW] * 4, *[1.0] * 20)[4:] == [LOST] * 21
