"""When scans stop fitting the map, and when that is over."""

from __future__ import annotations

import numpy as np

from moteslam.slam.filter.certainty import NEIGHBOURHOOD, LocalisationState
from moteslam.slam.filter.misfit import DOUBTFUL_DROP, LEAST_SPREAD, LOST_DROP, Misfit

SURE, DOUBTFUL, LOST = LocalisationState
STEP = 0.25
DOUBTFUL_BELOW, LOST_BELOW = DOUBTFUL_DROP * LEAST_SPREAD, LOST_DROP * LEAST_SPREAD
"""Where the scores before were all the same."""


class Drive:
    """A robot that drives straight on, 0.25 m a scan; every scan is an update."""

    def __init__(self) -> None:
        self.misfit, self.x = Misfit(), 0.0

    def on(self, distance: float, score: float, *, back: bool = False) -> list[LocalisationState]:
        states = []
        for _ in range(round(distance / STEP)):
            self.x += -STEP if back else STEP
            self.misfit.observe(STEP, score)
            self.misfit.update((self.x, 0.0, 0.0))
            states.append(self.misfit.state)
        return states


def test_scores_that_hardly_change_are_sure():
    drive = Drive()
    assert set(drive.on(8, 1.0) + drive.on(8, 1.0 - 0.9 * DOUBTFUL_BELOW) + drive.on(8, 1.1)) == {SURE}


def test_a_slow_change_is_no_misfit():
    drive = Drive()
    assert {s for score in np.arange(1.0, 0.3, -0.05) for s in drive.on(3, score)} == {SURE}


def test_where_scores_vary_a_larger_drop_is_needed():
    """Every other scan scores 0.2 less: the standard deviation is 0.1, so that 0.5 more is doubtful, and no more."""
    drive = Drive()
    for _ in range(100):
        drive.on(STEP, 1.1)
        drive.on(STEP, 0.9)
    assert drive.misfit.state is SURE
    assert drive.on(STEP, 1.0 - 1.5 * LOST_BELOW) == [DOUBTFUL]
    assert drive.on(STEP, 1.0 - 1.2 * LOST_DROP * 0.1) == [LOST]


def test_a_small_drop_is_doubtful_until_the_map_around_is_new():
    drive = Drive()
    drive.on(10, 1.0)
    states = drive.on(STEP, 1.0 - 1.1 * DOUBTFUL_BELOW) + drive.on(NEIGHBOURHOOD + 1, 1.0)
    assert states[0] is DOUBTFUL
    assert states[round(NEIGHBOURHOOD / STEP)] is DOUBTFUL
    assert states[-1] is SURE


def test_a_lost_robot_is_lost_until_nothing_around_it_is_from_before():
    drive = Drive()
    drive.on(10, 1.0)
    states = drive.on(STEP, 1.0 - 1.1 * LOST_BELOW) + drive.on(NEIGHBOURHOOD + 1, 0.85)
    assert states[0] is states[round(NEIGHBOURHOOD / STEP) - 1] is LOST
    assert states[-1] is SURE


def test_a_lost_robot_that_stays_among_the_old_scans_stays_lost():
    drive = Drive()
    drive.on(10, 1.0)
    assert set(drive.on(STEP, 1.0 - 1.1 * LOST_BELOW) + drive.on(9, 0.85, back=True)) == {LOST}


def test_scans_that_fit_as_before_end_it():
    """One scan was spoilt; all others fit as they did, among the old scans."""
    drive = Drive()
    drive.on(10, 1.0)
    assert drive.on(STEP, 1.0 - 1.1 * LOST_BELOW) == [LOST]
    assert drive.on(9, 1.0, back=True)[-1] is SURE


def test_scans_that_are_left_out_do_not_lower_the_bar():
    """A robot that stands in a crowd: the same low score is a misfit every time."""
    misfit = Misfit()
    for _ in range(10):
        misfit.observe(0.1, 1.0)
    for _ in range(50):
        misfit.observe(0.1, -0.1, left_out=True)
    assert misfit.state is LOST
    misfit.observe(0.1, 1.0)
    misfit.observe(0.1, 1.0 - 1.1 * DOUBTFUL_BELOW)
    assert misfit.state is LOST


def test_corrected_poses_replace_those_before():
    """The back end moves the old part of the path far away: nothing around the robot is from before any more."""
    drive = Drive()
    drive.on(10, 1.0)
    drive.on(STEP, 1.0 - 1.1 * LOST_BELOW)
    drive.on(NEIGHBOURHOOD + 1, 0.85, back=True)
    assert drive.misfit.state is LOST
    updates = round((10 + STEP + NEIGHBOURHOOD + 1) / STEP)
    poses = np.zeros((updates, 3))
    poses[: round(10 / STEP), 0] = 100.0
    drive.misfit.revise(poses)
    assert drive.on(STEP, 0.85)[-1] is SURE


def test_whether_anything_around_is_from_before_is_seen_at_every_place_as_by_looking_at_all_of_them():
    """Along a path that comes back twice, and after a correction of the places before."""
    turns = np.repeat(np.random.default_rng(4).normal(0, 0.3, 60), 5)
    path = np.cumsum(STEP * np.stack((np.cos(np.cumsum(turns)), np.sin(np.cumsum(turns))), axis=1), axis=0)
    for revised in (False, True):
        misfit = Misfit()
        for x, y in path[:40].tolist():
            misfit.observe(STEP, 1.0)
            misfit.update((x, y, 0.0))
        before, driven, states = path[:40], 0.0, []
        misfit.observe(STEP, 1.0 - 1.1 * LOST_BELOW)
        for k, (x, y) in enumerate(path[40:].tolist(), start=41):
            if revised and k == 100:
                before = before + np.array((6.0, 0.0))
                moved = np.zeros((k - 1, 3))
                moved[:40, :2], moved[40:, :2] = before, path[40 : k - 1]
                misfit.revise(moved)
            misfit.observe(STEP, 0.85)
            driven += STEP
            misfit.update((x, y, 0.0))
            near = (np.hypot(*(before - (x, y)).T) <= NEIGHBOURHOOD).any()
            states.append((misfit.state is LOST, bool(near or driven <= NEIGHBOURHOOD)))
            if misfit.state is not LOST:
                break
        assert all(lost == near for lost, near in states)
        assert not states[-1][0]
        assert len(states) > 25
