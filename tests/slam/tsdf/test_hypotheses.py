"""Several hypotheses: particles at every place that a search cannot tell apart, and what waits until one is left."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from slam_rooms import circled_room
from tile_pools import room_scan, thinned

from moteslam.robot import se2
from moteslam.slam.backend.protocol import KeyScan
from moteslam.slam.config import resolve_config
from moteslam.slam.filter.protocol import StepResult
from moteslam.slam.filter.update_policy import Travelled
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.step import Step
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.odometry.calibration import CalibrationConfig
from moteslam.slam.online import OnlineSlam
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.registration.localisation import Localiser, Located, Rivals
from moteslam.slam.tsdf.config import ProposalConfig
from moteslam.slam.tsdf.filter import TsdfFilter
from moteslam.slam.tsdf.motion import MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.proposal import propose
from moteslam.slam.tsdf.tracking import Tracker

pytestmark = pytest.mark.usefixtures("taichi")

Array = NDArray[np.float64]
SHARE = 0.1
RIVALS = Rivals(
    np.array([(0.0, 2.6, 0.0), (0.0, -2.6, 0.0)]),
    np.array((0.0, np.log(0.5) / SHARE)),
    np.array((np.log(2.0), np.log(2.0))),
)
"""Odds of a half and a quarter, by the cost of the offset and by both."""


def particles_at(poses: Array, best: int = 0) -> Particles:
    particles = Particles(len(poses), TsdfConfig())
    particles.move_to(poses)
    particles.best = best
    return particles


def divided(particles: Particles, rivals: Rivals = RIVALS) -> Array:
    return particles.divide(rivals.offsets, rivals.log_odds(SHARE))


def mapped(number: int) -> Particles:
    """With the map of a scan from the middle of a room."""
    particles = Particles(number, TsdfConfig())
    particles.start(thinned(room_scan()))
    return particles


def test_particles_are_divided_among_rival_places_by_their_odds_and_the_best_one_stays():
    found = divided(particles_at(np.zeros((28, 3)), best=9))
    chosen = [int((found == place).all(axis=1).sum()) for place in (np.zeros(3), *RIVALS.offsets)]
    assert chosen == [16, 8, 4]
    np.testing.assert_array_equal(found[9], 0.0)
    np.testing.assert_array_equal(divided(particles_at(np.zeros((4, 3))), Rivals()), np.zeros((4, 3)))


def test_a_place_where_a_particle_is_already_gets_none_and_those_away_stay():
    poses = np.zeros((12, 3))
    poses[5:] = (0.1, 2.5, 0.05)
    found = divided(particles_at(poses))
    np.testing.assert_array_equal(found[5:], 0.0)
    assert set(found[:5, 1].tolist()) == {0.0, -2.6}
    poses[5:] = (0.0, 0.0, 3.12)  # but for a whole circle the place of the rival
    alike = Rivals(np.array([(0.0, 0.0, -3.12)]), np.zeros(1), np.zeros(1))
    np.testing.assert_array_equal(divided(particles_at(poses), alike), 0.0)


@pytest.mark.parametrize(("weight", "alone"), [(0.0005, True), (0.005, False)])
def test_particles_are_settled_once_next_to_no_weight_is_on_another_hypothesis(weight: float, alone: bool):
    particles = particles_at(np.zeros((28, 3)))
    assert particles.settled
    divided(particles)
    assert not particles.settled
    sent = particles.hypotheses != particles.hypotheses[0]
    particles.weights = Weights(np.log(np.where(sent, weight / sent.sum(), (1 - weight) / (~sent).sum())))
    assert particles.settled is alone


def test_particles_that_drift_apart_are_of_one_hypothesis_and_those_that_come_together_too():
    particles = mapped(28)
    divided(particles)
    numbers = particles.hypotheses.copy()
    assert len(set(numbers.tolist())) == 3
    particles.resample(np.arange(28)[::-1].copy())
    np.testing.assert_array_equal(particles.hypotheses, numbers[::-1])
    particles.join()
    assert particles.settled
    drifted = np.zeros((28, 3))
    drifted[14:, 0] = 0.9
    particles.move_to(drifted)
    particles.join()
    assert particles.settled


def test_a_particle_that_looks_elsewhere_begins_at_its_place_whatever_the_odometry_was_off_by():
    """The scan fits at the tracked pose only; the second particle looks 0.2 m beside it, and comes back."""
    particles = mapped(2)
    at, odometry = np.array((0.5, 0.3, 0.6)), np.array((0.3, 0.1, 0.1))
    since = MotionSinceUpdate(tracked=at, odometry=odometry, travelled=Travelled(0.6, 0.6, 1.0))
    offset = np.array((0.1, -0.2, 0.05))
    configs = (ProposalConfig(), RegistrationConfig(), TrackingConfig())
    places = np.stack((np.zeros(3), offset))
    found = propose(particles, since, thinned(room_scan(at)), np.zeros(2), *configs, measured=True, places=places)
    start = se2.compose(found.predicted, se2.between(odometry, at))
    np.testing.assert_allclose(start, (at, se2.compose(at, offset)), atol=1e-12)
    np.testing.assert_allclose(found.means[0], at, atol=0.01)


def filter_of(*settings: str) -> TsdfFilter:
    config = resolve_config("default", ["particles=12", *settings])
    return TsdfFilter(config, 0)


def stepped(tsdf: TsdfFilter, index: int, ahead: float, points: NDArray[np.float32]) -> StepResult:
    return tsdf.step(Step(index, 0.1 * index, 0.1, np.array((ahead, 0.0, 0.0)), True, points, np.zeros(2)))


def test_a_scan_after_an_outage_is_no_slip_of_the_wheels_but_does_not_weigh_as_measured_motion():
    """A hundred scans without points, 0.1 m each to and fro; then the robot is 0.6 m off: all particles fit alike."""
    tsdf = filter_of("calibration.enabled=false")
    stepped(tsdf, 0, 0.0, room_scan())
    for k in range(1, 101):
        stepped(tsdf, k, 0.1 if k % 2 else -0.1, room_scan()[:0])
    at = np.array((0.4, 0.45, 0.01))
    stepped(tsdf, 101, 0.1, room_scan(at))
    assert tsdf.weights.effective_number > 6
    np.testing.assert_allclose(tsdf.poses[tsdf.best_particle], at, atol=0.002)


def test_rivals_divide_the_particles_even_where_no_update_is_due(monkeypatch: pytest.MonkeyPatch):
    tsdf = filter_of()
    stepped(tsdf, 0, 0.0, room_scan())
    locate = Localiser.locate

    def with_rival(self: Localiser, *arguments: Any, **keys: Any) -> Located:
        found = locate(self, *arguments, **keys)
        return found._replace(rivals=Rivals(np.array([(0.0, 0.0, np.pi)]), np.zeros(1), np.zeros(1)))

    monkeypatch.setattr(Localiser, "locate", with_rival)
    assert stepped(tsdf, 1, 0.0, room_scan()).updated
    assert not tsdf.settled
    assert int((np.abs(tsdf.poses[:, 2]) > 3).sum()) == 6


def test_after_a_time_without_scans_the_robot_is_looked_for_as_far_as_its_odometry_may_be_off():
    """Eight metres to and fro without a scan, then one from half a metre beside the prediction."""
    particles = mapped(1)
    at = np.array((0.1, 0.7, 0.02))
    blind = thinned(np.zeros((0, 2), np.float32))

    def off(steps: int, turn: float = 0.0) -> float:
        config = TrackingConfig(relocation_distance=0.5, relocation_rotation=0.0, max_lost_scans=0)
        tracker = Tracker(config, RegistrationConfig(), CalibrationConfig(enabled=False))
        for k in range(steps):
            sign = 1 if k % 2 else -1
            motion = tracker.predict((0.4 * sign, 0.0, turn * sign), 1.0, measured=True)
            tracker.track(motion, blind, (0.0, 0.0), particles)
        motion = tracker.predict((0.0, 0.0, 0.0), 1.0, measured=True)
        tracker.track(motion, thinned(room_scan(at)), (0.0, 0.0), particles)
        return float(np.abs(se2.between(tracker.pose, at)).max())

    assert off(0) > 0.1
    assert off(20) < 0.01
    # a metre and a half is too short a distance by itself, but not with what the heading may be off by
    assert off(4) > 0.1
    assert off(4, turn=0.5) < 0.01


class Watched:
    """A back end that keeps what it is given, and corrects once."""

    loops = ()

    def __init__(self, correct_at: int = -1) -> None:
        self.keys: list[KeyScan] = []
        self._correct_at = correct_at

    def add(self, key: KeyScan) -> Array | None:
        self.keys.append(key)
        if len(self.keys) != self._correct_at:
            return None
        return np.asarray(se2.compose((0.0, 1.0, 0.0), np.array([each.pose for each in self.keys])))

    def finish(self, path: Array) -> Array | None:
        return None


def run(monkeypatch: pytest.MonkeyPatch, backend: Watched, *, open_at: range) -> tuple[OnlineSlam, list[int]]:
    """A run that is not settled at some updates; how many key scans the back end had after each update."""
    updates = [0]

    def now_settled(self: TsdfFilter) -> bool:
        updates[0] += 1
        return updates[0] not in open_at

    monkeypatch.setattr(TsdfFilter, "settled", property(now_settled))
    session = OnlineSlam.over(circled_room(scans=60)[0], resolve_config("default", ["particles=8"]))
    monkeypatch.setattr(session, "_backend", backend)
    return session, [len(backend.keys) for update in session if update.updated]


def test_key_scans_wait_until_the_particles_are_settled_and_come_in_order(monkeypatch: pytest.MonkeyPatch):
    backend = Watched()
    session, given = run(monkeypatch, backend, open_at=range(5, 9))
    assert given[:10] == [1, 2, 3, 4, 4, 4, 4, 4, 9, 10]
    indices = [key.index for key in backend.keys]
    assert indices == sorted(set(indices))
    assert len(indices) == len(given)
    steps = se2.between(np.array([key.pose for key in backend.keys[4:8]]), [key.pose for key in backend.keys[5:9]])
    np.testing.assert_allclose(steps, [key.motion for key in backend.keys[5:9]], atol=1e-12)
    assert np.isfinite(session.estimate().trajectory_final.poses).all()
    _, given = run(monkeypatch, backend := Watched(), open_at=range(5, 10_000))
    assert set(given[4:]) == {4}
    assert len(backend.keys) == len(given)  # those that wait at the end are given too


def test_a_correction_by_a_scan_that_has_waited_moves_those_after_it(monkeypatch: pytest.MonkeyPatch):
    plain, corrected = Watched(), Watched(correct_at=7)
    with monkeypatch.context() as context:
        as_it_was, _ = run(context, plain, open_at=range(5, 9))
    revised, _ = run(monkeypatch, corrected, open_at=range(5, 9))
    before, after = (np.array([key.pose for key in backend.keys]) for backend in (plain, corrected))
    np.testing.assert_array_equal(before[:7], after[:7])
    np.testing.assert_allclose(after[7:9], se2.compose((0.0, 1.0, 0.0), before[7:9]), atol=1e-9)
    one, other = ([key.motion for key in backend.keys[7:9]] for backend in (plain, corrected))
    np.testing.assert_allclose(one, other, atol=1e-9)
    moved = se2.between(as_it_was.estimate().trajectory_final.poses, revised.estimate().trajectory_final.poses)
    np.testing.assert_allclose(np.hypot(moved[:, 0], moved[:, 1]), 1.0, atol=0.03)


def test_an_estimate_while_key_scans_wait_has_all_poses(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(TsdfFilter, "settled", property(lambda self: len(self.history) < 8))
    session = OnlineSlam.over(circled_room(scans=60)[0], resolve_config("default", ["particles=8"]))
    for update in session:
        if update.index == 50:
            final = session.estimate().trajectory_final
    assert len(final) == 51
    np.testing.assert_allclose(final.poses[-1], session.estimate().trajectory_final.poses[50], atol=0.02)
