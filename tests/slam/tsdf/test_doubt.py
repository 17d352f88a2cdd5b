"""When scans contradict the map, and when that is taken for a robot that is lost."""

import numpy as np
import pytest

from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.filter.misfit import LEAST_SPREAD, LOST_DROP
from moteslam.slam.tsdf.doubt import APART, PRIOR, Doubt, ScanFit

SURE, DOUBTFUL, LOST = LocalisationState
LOW = 1.0 - 1.2 * LOST_DROP * LEAST_SPREAD
FITS = ScanFit(1.0, 200.0, 180.0, 0.0, 0.0)
ELSEWHERE = ScanFit(LOW, 200.0, 150.0, 25.0, 10.0)
"""A sixth of the known endpoints far from the surface."""
BENT = ScanFit(LOW, 200.0, 180.0, 0.0, 0.0)
"""As low a score, but no endpoint far from the surface."""


def watched(*scans: ScanFit | None, driven: float = 0.1, calm: int = 100) -> list[float]:
    """The probability after each scan, of a robot that drove through a known place before."""
    doubt, found = Doubt(), []
    for seen in [*([FITS] * calm), *scans]:
        doubt.observe(driven, seen)
        found.append(doubt.probability)
    assert max(found[:calm]) == pytest.approx(1 / (1 + np.exp(-PRIOR)))
    return found[calm:]


def states(*scans: ScanFit | None, driven: float = 0.1) -> list[LocalisationState]:
    doubt, found = Doubt(), []
    for seen in [*([FITS] * 100), *scans]:
        doubt.observe(driven, seen)
        found.append(doubt.state)
    return found[100:]


def test_a_robot_that_sees_another_place_is_doubtful_at_once_and_lost_within_a_metre():
    found = states(*[ELSEWHERE] * 10)
    assert found[0] is DOUBTFUL
    assert found == sorted(found)
    assert APART / 0.1 < found.index(LOST) < 2 * APART / 0.1


def test_two_scans_make_no_robot_lost_nor_do_many_from_one_place():
    assert states(*[ELSEWHERE] * 3, driven=5.0) == [DOUBTFUL, DOUBTFUL, LOST]
    assert set(states(*[ELSEWHERE] * 500, driven=0.0)) == {DOUBTFUL}


def test_scans_that_fit_again_end_the_doubt():
    found = watched(*[ELSEWHERE] * 2, *[FITS] * 60)
    assert found[1] > 0.05
    assert found[-1] < 0.05
    assert (np.diff(found[1:]) <= 0).all()


def test_neither_a_map_that_bends_nor_what_changes_little_by_little_makes_a_robot_lost():
    assert set(states(*[BENT] * 50)) == {SURE}
    scores = np.arange(1.0, 0.2, -0.05).repeat(2)
    assert set(states(*[FITS._replace(score=score, crossed=60.0) for score in scores])) == {SURE}


def test_rays_through_surfaces_count_with_a_drop_of_the_score_and_beyond_what_is_usual():
    hidden = BENT._replace(crossed=40.0)
    assert watched(hidden)[0] > watched(BENT)[0]
    assert watched(FITS._replace(crossed=190.0))[0] == watched(FITS)[0]
    doubt = Doubt()
    for _ in range(1000):
        doubt.observe(0.1, FITS._replace(crossed=40.0))
    doubt.observe(0.1, hidden)
    assert doubt.probability < watched(hidden)[0]


def test_where_many_endpoints_are_far_from_the_surface_that_is_usual():
    crowd = FITS._replace(far=12.0)
    doubt = Doubt()
    for _ in range(300):
        doubt.observe(0.1, crowd)
        assert doubt.state is SURE
    doubt.observe(0.1, ELSEWHERE._replace(far=12.0))
    assert doubt.probability < watched(ELSEWHERE._replace(far=12.0))[0]


def test_a_scan_that_fits_where_next_to_nothing_is_known_and_one_that_is_not_matched_end_no_doubt():
    fits_here = FITS._replace(known=60.0)
    assert watched(ELSEWHERE, *[fits_here] * 5)[-1] > 0.1
    assert watched(ELSEWHERE, *[FITS] * 5)[-1] < 0.05
    assert len(set(watched(ELSEWHERE, None, None))) == 1


def test_a_robot_that_was_carried_is_found_where_scans_fit_as_usual_and_else_is_lost():
    for seen, state in ((FITS, SURE), (FITS._replace(score=0.9), LOST), (FITS._replace(known=100.0), LOST)):
        doubt = Doubt()
        for _ in range(100):
            doubt.observe(0.1, FITS)
        doubt.observe(0.0, seen, carried=True)
        assert doubt.state is DOUBTFUL
        for _ in range(12):
            doubt.observe(0.1, seen)
        assert doubt.state is state
        assert doubt.carried is (state is LOST)
