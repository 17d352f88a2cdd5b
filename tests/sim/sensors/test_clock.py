"""When sensors read and how the host stamps them."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.robot.noise import ClockNoise
from moteslam.robot.platforms import UCSD
from moteslam.sim.sensors.clock import readings


def test_a_perfect_clock() -> None:
    times, stamps = readings(40.0, 0.5, 2.5, ClockNoise(), np.random.default_rng(0))
    np.testing.assert_allclose(times, 0.5 + np.arange(81) / 40)
    np.testing.assert_array_equal(times, stamps)


@pytest.mark.parametrize("noise", [UCSD.noise.encoders.clock, UCSD.noise.imu.clock, UCSD.noise.lidar.clock])
def test_stamps_are_late_rise_and_catch_up(noise: ClockNoise) -> None:
    times, stamps = readings(100.0, 0.0, 100.0, noise, np.random.default_rng(1))
    assert (stamps >= times).all()
    assert np.diff(stamps).min() >= noise.burst_interval * 0.999
    assert (stamps - times).max() < noise.late_delay + 10 * noise.jitter + 0.01
    assert np.diff(times) == pytest.approx(np.diff(times)[0])


def test_a_reading_held_up_comes_out_in_a_burst() -> None:
    noise = ClockNoise(late=1.0, late_delay=0.1, burst_interval=0.001)
    times, stamps = readings(100.0, 0.0, 1.0, noise, np.random.default_rng(2))
    burst = np.isclose(np.diff(stamps), 0.001, rtol=1e-6)
    assert burst.sum() > 30
    assert (np.diff(times) > 0.009).all()


def test_a_span_too_short_still_has_a_reading() -> None:
    times, _ = readings(40.0, 1.0, 0.2, ClockNoise(), np.random.default_rng(0))
    np.testing.assert_array_equal(times, [1.0])
