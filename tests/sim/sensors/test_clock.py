"""When sensors read, how the host stamps them, and what arrives: lost messages, dead sensors, wrong clocks."""

from typing import Any

import numpy as np
import pytest

from moteslam.robot.noise import ClockNoise, Noise
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import EPOCH, Outage, readings, with_faults
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
