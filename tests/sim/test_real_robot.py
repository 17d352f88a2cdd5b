"""The bundled noise against the real robot: within a factor of 1.5 of what was measured on it.

The figures are those of the UCSD recordings (docs/reference/scenarios.md tables them).
"""

from collections.abc import Callable

import numpy as np
import pytest
from sim_drives import steady
from ucsd_robot import IMU

from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import load_scenario
from moteslam.sim.sensors.wheels_and_gyro import Encoders, Imu
from moteslam.sim.simulate import true_drive

FACTOR = 1.5
SEEDS = range(6)


def within(value: float, low: float, high: float, factor: float = FACTOR) -> bool:
    return low / factor <= value <= high * factor


@pytest.fixture(scope="module")
def corridor() -> Drive:
    scenario = load_scenario("corridor")
    return true_drive(scenario, 0)


def encoders(run: Drive, seed: int, scale: float = 1.0) -> EncoderStream:
    span = (0.1, float(run.stamps[-1]))
    rng, effects = np.random.default_rng(seed), np.random.default_rng(0)
    wheels = Encoders(UCSD, UCSD.noise.encoders, scale, span, rng, effects=effects)
    return wheels.read(run, len(wheels.times))


def imu(run: Drive, seed: int, scale: float = 1.0) -> ImuStream:
    span = (0.5, float(run.stamps[-1]) - 1.5)
    gyro = Imu(IMU, UCSD.noise.imu, scale, span, np.random.default_rng(seed))
    return gyro.read(run, len(gyro.times))


def effective_track(encoders: EncoderStream, imu: ImuStream) -> tuple[float, float]:
    """The track that explains the turns over half seconds [m], and the standard deviation of what it leaves [m]."""
    heading = np.concatenate(([0.0], np.cumsum(imu.angular_velocity[:-1, 2] * np.diff(imu.stamps))))
    inside = (encoders.stamps > imu.stamps[0]) & (encoders.stamps < imu.stamps[-1])
    right, left = encoders.counts[:, [0, 2]].mean(1), encoders.counts[:, [1, 3]].mean(1)
    difference = np.diff(np.cumsum(right - left)[inside][::20]) * 0.0022
    turn = np.diff(np.interp(encoders.stamps[inside], imu.stamps, heading)[::20])
    track = float(turn @ difference / (turn @ turn))
    return track, float((difference - turn * track).std())


def test_the_imu_steady() -> None:
    for seed in SEEDS:
        stream = imu(steady(900.0), seed)
        mean, spread = stream.linear_acceleration_g.mean(0), stream.linear_acceleration_g.std(0)
        assert mean == pytest.approx((0, 0, 1), abs=0.04)
        assert all(within(value, 0.0002, 0.0013) for value in spread)
        yaw_rate = stream.angular_velocity[:, 2]
        assert within(yaw_rate.std(), 0.0038, 0.0045)
        # a mean over 900 s: over a few seconds of rest the noise alone moves it by about 1 degree a minute
        assert within(np.degrees(abs(yaw_rate.mean())) * 60, 1.0, 1.3)
        noise = yaw_rate - yaw_rate.mean()
        for lag, measured in ((1, 0.91), (2, 0.69)):
            assert noise[lag:] @ noise[:-lag] / (noise @ noise) == pytest.approx(measured, abs=0.05)


def test_the_imu_in_motion(corridor: Drive) -> None:
    for seed in SEEDS:
        stream = imu(corridor, seed)
        moving = (stream.stamps > 10) & (stream.stamps < 100)
        assert all(within(value, 0.024, 0.028) for value in stream.linear_acceleration_g[moving, :2].std(0))
        assert within(stream.angular_velocity[moving, 2].std(), 0.376, 0.393)
        assert within(np.abs(stream.angular_velocity[:, 2]).max(), 1.2, 1.9)


@pytest.mark.parametrize(
    ("sensor", "mean", "spread", "shortest", "longest"),
    [(encoders, 25, (3.7, 6.1), (2.2, 5.0), (51, 68)), (imu, 10, (1.9, 2.2), (0.004, 0.1), (31, 37))],
)
def test_intervals_of_stamps_in_milliseconds(
    corridor: Drive,
    sensor: Callable[[Drive, int], EncoderStream | ImuStream],
    mean: float,
    spread: tuple[float, float],
    shortest: tuple[float, float],
    longest: tuple[float, float],
) -> None:
    """The shortest are those of bursts."""
    for seed in SEEDS:
        intervals = np.diff(sensor(corridor, seed).stamps) * 1000
        assert intervals.mean() == pytest.approx(mean, rel=0.005)
        assert within(intervals.std(), *spread)
        assert shortest[0] < intervals.min() < shortest[1]
        assert within(intervals.max(), *longest)


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


def test_odometry_scale_multiplies_the_errors(corridor: Drive) -> None:
    still = steady(60.0)
    one, three = (imu(still, 1, scale).angular_velocity[:, 2] for scale in (1.0, 3.0))
    np.testing.assert_allclose(three, 3 * one, atol=1e-12)
    exact, once, thrice = (encoders(corridor, 1, scale).counts.sum() for scale in (0.0, 1.0, 3.0))
    assert thrice - exact == pytest.approx(3 * (once - exact), abs=0.1 * abs(once - exact) + 8)
