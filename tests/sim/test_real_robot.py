"""The bundled noise against the real robot: within a factor of 1.5 of what was measured on it.

The figures are those of the UCSD recordings (docs/reference/scenarios.md tables them); where the recordings are at
hand, the same statistics are taken from them too, so that the figures themselves are tested.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from sim_drives import steady
from ucsd_robot import IMU

from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import load_scenario
from moteslam.sim.sensors.wheels_and_gyro import simulate_encoders, simulate_imu
from moteslam.sim.simulate import true_drive

FACTOR = 1.5
SEEDS = range(6)


def within(value: float, low: float, high: float, factor: float = FACTOR) -> bool:
    """Whether a value is within a factor of a measured range."""
    return low / factor <= value <= high * factor


@pytest.fixture(scope="module")
def corridor() -> Drive:
    scenario = load_scenario("corridor")
    return true_drive(scenario, 0)


def encoders(run: Drive, seed: int, scale: float = 1.0) -> EncoderStream:
    span = (0.1, float(run.stamps[-1]))
    return simulate_encoders(
        run, UCSD, UCSD.noise.encoders, scale, span, np.random.default_rng(seed), effects=np.random.default_rng(0)
    )


def imu(run: Drive, seed: int, scale: float = 1.0) -> ImuStream:
    span = (0.5, float(run.stamps[-1]) - 1.5)
    return simulate_imu(run, IMU, UCSD.noise.imu, scale, span, np.random.default_rng(seed))


def effective_track(encoders: EncoderStream, imu: ImuStream) -> tuple[float, float]:
    """The track that explains the turns over half seconds [m], and the standard deviation of what it leaves [m]."""
    heading = np.concatenate(([0.0], np.cumsum(imu.angular_velocity[:-1, 2] * np.diff(imu.stamps))))
    inside = (encoders.stamps > imu.stamps[0]) & (encoders.stamps < imu.stamps[-1])
    right, left = encoders.counts[:, [0, 2]].mean(1), encoders.counts[:, [1, 3]].mean(1)
    difference = np.diff(np.cumsum(right - left)[inside][::20]) * 0.0022
    turn = np.diff(np.interp(encoders.stamps[inside], imu.stamps, heading)[::20])
    track = float(turn @ difference / (turn @ turn))
    return track, float((difference - turn * track).std())


def test_the_gyro_steady() -> None:
    for seed in SEEDS:
        stream = imu(steady(900.0), seed)
        yaw_rate = stream.angular_velocity[:, 2]
        assert within(yaw_rate.std(), 0.0038, 0.0045)
        # a mean over 900 s: over a few seconds of rest the noise alone moves it by about 1 degree a minute
        assert within(np.degrees(abs(yaw_rate.mean())) * 60, 1.0, 1.3)
        noise = yaw_rate - yaw_rate.mean()
        for lag, measured in ((1, 0.91), (2, 0.69)):
            assert noise[lag:] @ noise[:-lag] / (noise @ noise) == pytest.approx(measured, abs=0.05)


def test_the_bias_has_either_sign() -> None:
    signs = {np.sign(imu(steady(300.0), seed).angular_velocity[:, 2].mean()) for seed in range(12)}
    assert signs == {-1.0, 1.0}


def test_the_accelerometer_steady() -> None:
    stream = imu(steady(60.0), 0)
    mean, spread = stream.linear_acceleration_g.mean(0), stream.linear_acceleration_g.std(0)
    assert mean == pytest.approx((0, 0, 1), abs=0.04)
    assert all(within(value, 0.0002, 0.0013) for value in spread)


def test_the_imu_in_motion(corridor: Drive) -> None:
    for seed in SEEDS:
        stream = imu(corridor, seed)
        moving = (stream.stamps > 10) & (stream.stamps < 100)
        assert all(within(value, 0.024, 0.028) for value in stream.linear_acceleration_g[moving, :2].std(0))
        assert within(stream.angular_velocity[moving, 2].std(), 0.376, 0.393)
        assert within(np.abs(stream.angular_velocity[:, 2]).max(), 1.2, 1.9)


def test_the_encoders_intervals(corridor: Drive) -> None:
    for seed in SEEDS:
        intervals = np.diff(encoders(corridor, seed).stamps) * 1000
        assert intervals.mean() == pytest.approx(25, rel=0.005)
        assert within(intervals.std(), 3.7, 6.1)
        assert within(intervals.min(), 3.2, 3.3)
        assert within(intervals.max(), 51, 68)


def test_the_imus_intervals(corridor: Drive) -> None:
    for seed in SEEDS:
        intervals = np.diff(imu(corridor, seed).stamps) * 1000
        assert intervals.mean() == pytest.approx(10, rel=0.005)
        assert within(intervals.std(), 1.9, 2.2)
        assert 0.004 < intervals.min() < 0.1  # bursts
        assert within(intervals.max(), 31, 37)


def test_the_effective_track(corridor: Drive) -> None:
    tracks, left = zip(*(effective_track(encoders(corridor, seed), imu(corridor, seed)) for seed in SEEDS), strict=True)
    assert np.mean(tracks) == pytest.approx(0.73, abs=0.02)
    assert all(0.69 < track < 0.77 for track in tracks)
    assert within(float(np.mean(left)), 0.013, 0.030)


def test_the_counts_sum_to_the_way(corridor: Drive) -> None:
    distances = np.array([encoders(corridor, seed).counts.sum(0) * 0.0022 for seed in range(20)])
    error = distances.mean(1) / corridor.truth.length - 1
    assert abs(error.mean()) < 0.004
    assert 0.002 < error.std() < 0.01
    counts = encoders(corridor, 0).counts
    assert counts.dtype == np.int64
    assert np.abs(counts).max() < 40


def test_a_counter_keeps_the_rest_of_a_tick(corridor: Drive) -> None:
    exact = encoders(corridor, 0, scale=0.0)
    np.testing.assert_allclose(exact.counts.sum(0) * 0.0022, corridor.wheel_travel[-1], atol=0.0022)


def test_odometry_scale_multiplies_the_errors(corridor: Drive) -> None:
    still = steady(60.0)
    one, three = (imu(still, 1, scale).angular_velocity[:, 2] for scale in (1.0, 3.0))
    np.testing.assert_allclose(three, 3 * one, atol=1e-12)
    exact, once, thrice = (encoders(corridor, 1, scale).counts.sum() for scale in (0.0, 1.0, 3.0))
    assert thrice - exact == pytest.approx(3 * (once - exact), abs=0.1 * abs(once - exact) + 8)


@pytest.mark.parametrize("sequence", [20, 21])
def test_the_figures_are_those_of_the_real_recordings(data_folder: Path, sequence: int) -> None:
    wheels = np.load(data_folder / "ucsd" / f"Encoders{sequence}.npz")
    gyro = np.load(data_folder / "ucsd" / f"Imu{sequence}.npz")
    encoders = EncoderStream(wheels["time_stamps"], wheels["counts"].T.astype(np.int64))
    imu = ImuStream(gyro["time_stamps"], gyro["angular_velocity"].T, gyro["linear_acceleration"].T)
    moving = encoders.stamps[encoders.counts.any(1)]
    rest = imu.stamps < moving[0] - 0.2
    noise = imu.angular_velocity[rest, 2] - imu.angular_velocity[rest, 2].mean()
    assert 0.0037 < noise.std() < 0.0046
    assert noise[1:] @ noise[:-1] / (noise @ noise) == pytest.approx(0.91, abs=0.02)
    assert noise[2:] @ noise[:-2] / (noise @ noise) == pytest.approx(0.69, abs=0.03)
    assert 3.7 < np.diff(encoders.stamps).std() * 1000 < 6.2
    assert 1.9 < np.diff(imu.stamps).std() * 1000 < 2.3
    track, left = effective_track(encoders, imu)
    assert 0.71 < track < 0.76
    assert 0.012 < left < 0.031
    assert 0.28 < imu.stamps[0] - encoders.stamps[0] < 0.5
    assert 1.4 < encoders.stamps[-1] - imu.stamps[-1] < 1.6
