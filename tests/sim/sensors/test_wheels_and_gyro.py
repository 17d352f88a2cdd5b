"""When sensors read and what arrives; what wheel counters and gyro add to the truth, one error at a time."""

from typing import Any

import numpy as np
import pytest
from sim_drives import steady
from ucsd_robot import ENCODERS, IMU, WHEELS

from moteslam.robot.noise import ClockNoise, EncoderNoise, ImuNoise, Noise
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import EPOCH, Outage, readings, with_faults
from moteslam.sim.sensors.wheels_and_gyro import Encoders, Imu
from moteslam.sim.simulate import simulate

STREAM = EncoderStream(np.arange(10_000) / 40.0, np.arange(40_000).reshape(10_000, 4))


HELD_UP = ClockNoise(late=1.0, late_delay=0.1, burst_interval=0.001)


@pytest.mark.parametrize(
    "noise", [ClockNoise(), HELD_UP, UCSD.noise.encoders.clock, UCSD.noise.imu.clock, UCSD.noise.lidar.clock]
)
def test_stamps_are_late_rise_and_catch_up(noise: ClockNoise) -> None:
    times, stamps = readings(100.0, 0.0, 100.0, noise, np.random.default_rng(1))
    assert times[0] == 0.0
    assert (stamps >= times).all()
    assert np.diff(stamps).min() >= noise.burst_interval * 0.999
    assert (stamps - times).max() < noise.late_delay + 10 * noise.jitter + 0.01
    assert np.diff(times) == pytest.approx(0.01, rel=0.01)
    if noise is HELD_UP:  # and comes out in bursts
        assert np.isclose(np.diff(stamps), noise.burst_interval, rtol=1e-6).sum() > 3000


def test_a_share_of_the_messages_is_lost_whole() -> None:
    kept = with_faults(STREAM, ClockNoise(lost=0.2), [], np.random.default_rng(0))
    assert len(kept) / 10_000 == pytest.approx(0.8, abs=0.02)
    np.testing.assert_array_equal(kept.counts[:, 0], 4 * np.round(kept.stamps * 40))  # each stamp has its own counts


def test_a_dead_sensor_is_silent_and_comes_back() -> None:
    outages = [Outage(sensor="encoders", start=start, duration=long) for start, long in ((10.0, 5.0), (200.0, 99.0))]
    kept = with_faults(STREAM, ClockNoise(), outages, np.random.default_rng(0))
    assert len(kept) == 10_000 - 200 - 99 * 40 + (299 - 250) * 40
    assert not ((kept.stamps >= 10.0) & (kept.stamps < 15.0)).any()
    assert 15.0 in kept.stamps


def test_a_clock_that_is_off_and_drifts_and_one_without_faults() -> None:
    rng = np.random.default_rng(0)
    moved = with_faults(STREAM, ClockNoise(offset=-0.5, drift=1e-3), [], rng)
    np.testing.assert_allclose(moved.stamps, STREAM.stamps * 1.001 - 0.5)
    assert with_faults(STREAM, ClockNoise(), [], rng) is STREAM
    assert rng.random() == np.random.default_rng(0).random()  # nothing was drawn


@pytest.mark.usefixtures("taichi")
def test_faults_of_one_sensor_leave_the_others_and_the_truth_as_they_were(table: dict[str, Any]) -> None:
    noise = Noise().model_dump()
    plain = simulate(parse_scenario({**table, "noise": noise}), seed=2)
    noise["lidar"]["clock"] |= {"lost": 0.3, "offset": 0.25}
    outages = [{"sensor": "lidar", "start": 2.0, "duration": 1.5}]
    faulty = simulate(parse_scenario({**table, "noise": noise, "outages": outages}), seed=2)
    assert faulty.truth.poses.tobytes() == plain.truth.poses.tobytes()
    ours, theirs = faulty.recording, plain.recording
    assert ours.encoders.counts.tobytes() == theirs.encoders.counts.tobytes()
    at = np.searchsorted(theirs.lidar.stamps, ours.lidar.stamps - 0.25 - 1e-6)
    np.testing.assert_array_equal(ours.lidar.ranges, theirs.lidar.ranges[at])
    silent = ours.lidar.stamps - EPOCH - 0.25
    assert not ((silent > 2.0) & (silent < 3.5)).any()
    assert len(ours.lidar) < 0.8 * len(theirs.lidar)


def travel(drive: Drive, seed: int = 0, **errors: Any) -> np.ndarray:
    """The travel [n, 4] [m] of the FR, FL, RR, RL wheel between readings as counted, with these errors alone."""
    noise, span = EncoderNoise(**errors), (0.0, float(drive.stamps[-1]))
    rng, effects = np.random.default_rng(seed), np.random.default_rng(0)
    wheels = Encoders(UCSD, noise, 1.0, span, rng, effects=effects)
    stream = wheels.read(drive, len(wheels.times))
    return stream.counts[1:] * WHEELS.metres_per_count


def test_a_side_slips_for_half_a_second_at_a_time_and_the_other_side_as_it_likes() -> None:
    slip, window = 0.02, round(0.5 * ENCODERS.rate)
    counted = travel(steady(400.0, speed=1.0), slip=slip, slip_time=0.5)
    parts = counted[: len(counted) // window * window].reshape(-1, window, 4).sum(axis=1)
    off = parts / (window / ENCODERS.rate) - 1  # relative, over half seconds
    # the mean of noise of this correlation time over a window of the same length has (2 / e) of its variance
    assert off.std(axis=0) == pytest.approx(slip * np.sqrt(2 / np.e), rel=0.1)
    correlation = np.corrcoef(off.T)
    assert min(correlation[0, 2], correlation[1, 3]) > 0.98  # front and rear of a side
    assert abs(correlation[0, 1]) < 0.15


def test_a_wrong_track_shows_in_turns_and_not_straight_on() -> None:
    def turned(seed: int) -> float:
        """The turn that the counters show over the true one, less 1."""
        counted = travel(steady(10.0, turn_rate=1.0), seed, track_error=0.03).sum(axis=0)
        return float((counted[[0, 2]].mean() - counted[[1, 3]].mean()) / WHEELS.effective_track / 10.0 - 1)

    errors = np.array([turned(seed) for seed in range(100)])
    assert errors.std() == pytest.approx(0.03, rel=0.2)
    assert abs(errors.mean()) < 0.01
    np.testing.assert_array_equal(travel(steady(10.0, speed=1.0), track_error=0.03), travel(steady(10.0, speed=1.0)))


def test_radii_missed_ticks_and_bursts() -> None:
    drive = steady(60.0, speed=0.5)
    factors = (1.0, 1.1, 1.0, 0.9)
    np.testing.assert_allclose(travel(drive).sum(0), 30.0, atol=0.03)
    np.testing.assert_allclose(travel(drive, radius_factors=factors).sum(0) * factors, 30.0, atol=0.03)
    np.testing.assert_allclose(travel(drive, missed=0.1).sum(0), 0.9 * 30.0, rtol=0.01)
    fr, fl, rr, rl = travel(drive, bursts=20.0, burst_slip=1.0, burst_time=0.5).sum(0)
    assert (fr, fl) == pytest.approx((rr, rl), abs=0.01)  # one side at a time
    assert (fr - 30.0) + (fl - 30.0) == pytest.approx(20 * 0.5 * 0.5, rel=0.6)  # 20 of half a second at 0.5 m/s
    assert fr != fl


def angular_velocity(drive: Drive, seed: int = 0, **errors: float) -> np.ndarray:
    """The readings [n, 3] [rad/s] with these errors alone."""
    noise = ImuNoise(**errors)
    span = (0.01, float(drive.stamps[-1]))
    imu = Imu(IMU, noise, 1.0, span, np.random.default_rng(seed))
    return imu.read(drive, len(imu.times)).angular_velocity


def test_the_scale_error_is_one_factor_a_recording() -> None:
    turning = steady(1.0, turn_rate=1.0)
    rates = np.array([angular_velocity(turning, seed, gyro_scale_error=0.02)[:, 2] for seed in range(200)])
    assert np.ptp(rates, axis=1).max() < 1e-9
    assert rates.mean() == pytest.approx(1.0, abs=0.01)
    assert (rates[:, 0] - 1).std() == pytest.approx(0.02, rel=0.15)
    assert not angular_velocity(steady(1.0), gyro_scale_error=0.02).any()


def test_the_bias_walks_with_the_root_of_time() -> None:
    walk, still = 1e-4, steady(100.0)
    readings = np.array([angular_velocity(still, seed, gyro_bias_walk=walk) for seed in range(80)])
    # three axes, each with a walk of its own
    for seconds in (25, 100):
        size = np.sqrt(np.square(readings[:, 100 * seconds - 1]).mean())
        assert size == pytest.approx(walk * np.sqrt(seconds), rel=0.15)
    steps = np.diff(readings[0], axis=0)
    assert steps.std() == pytest.approx(walk * np.sqrt(0.01), rel=0.05)


def test_the_bias_is_as_measured_to_either_side_with_its_spread_and_five_times_that_of_roll_and_pitch() -> None:
    bias = [angular_velocity(steady(0.1), seed, gyro_bias=1e-3, gyro_bias_spread=0.1)[0] for seed in range(300)]
    size = np.abs(bias) / 1e-3
    assert size.mean(axis=0) == pytest.approx((5, 5, 1), rel=0.03)
    assert size.std(axis=0) == pytest.approx((0.5, 0.5, 0.1), rel=0.15)
    assert (np.array(bias) > 0).mean(axis=0) == pytest.approx(0.5, abs=0.1)
