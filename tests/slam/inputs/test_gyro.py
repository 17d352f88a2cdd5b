"""The gyro's yaw rates as they come: the low-pass, and a gyro that hangs."""

import numpy as np
import pytest

from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.inputs.odometry_path import HANGS, Gyro, LowPass, about_hanging


def test_the_low_pass_is_scipys_butterworth_whatever_comes_later():
    from scipy.signal import butter, sosfilt, sosfilt_zi

    def low_pass(values: np.ndarray, stamps: np.ndarray, cut_off: float) -> np.ndarray:
        passing = LowPass(cut_off)
        return np.array([passing.of(*each) for each in zip(values.tolist(), stamps.tolist(), strict=True)])

    values, stamps = np.random.default_rng(0).standard_normal(500), 5.0 + np.arange(500) / 100
    sections = butter(1, 10, fs=100, output="sos")
    expected, _ = sosfilt(sections, values, zi=sosfilt_zi(sections) * values[0])
    np.testing.assert_allclose(low_pass(values, stamps, 10), expected, atol=1e-12)
    late = stamps + np.where(np.arange(500) > 300, 2.0, 0.0)
    assert low_pass(values, late, 10)[:301].tobytes() == low_pass(values, stamps, 10)[:301].tobytes()
    np.testing.assert_array_equal(low_pass(values, stamps, 0), values)
    np.testing.assert_array_equal(low_pass(values, stamps, 51), values)  # above half the rate


@pytest.mark.parametrize("config", [SyncConfig(), SyncConfig(low_pass_hz=10.0)], ids=["as it is", "low-pass"])
def test_a_gyro_that_repeats_a_yaw_rate_hangs_and_the_wheels_say_how_the_robot_turns(config: SyncConfig) -> None:
    rng, stamps = np.random.default_rng(1), 1e9 + np.arange(3000) / 100
    rates = 0.3 + 0.01 * rng.standard_normal(3000)
    rates[1000:2000] = rates[1000]
    hangs = stamps[1000] + HANGS
    turns = []
    for at_a_time in (1, 7, 3000):
        gyro = Gyro(config)
        for first in range(0, 3000, at_a_time):
            gyro.add(stamps[first : first + at_a_time], rates[first : first + at_a_time, None])
        ends = stamps[::10]
        turns.append(gyro.turns(ends, np.full(len(ends) - 1, -1.0)))
        assert gyro.hung == [(stamps[1000], stamps[1999])]
        assert gyro.heard == stamps[-1]
        by_wheels = turns[-1] == -1.0
        assert not by_wheels[ends[1:] < hangs - 0.11].any()
        assert by_wheels[(ends[1:] > hangs + 0.11) & (ends[1:] < stamps[1999])].all()
        assert not by_wheels[ends[1:] > stamps[2010]].any()
    assert turns[0].tobytes() == turns[1].tobytes() == turns[2].tobytes()
    (issue,) = about_hanging(gyro.hung)
    assert issue.code == "no-gyro"
    assert "from 1000000010.00 to 1000000019.99 s" in issue.message


@pytest.mark.parametrize(
    "rates",
    [
        np.zeros(3000),  # of a robot that stands
        np.repeat(np.random.default_rng(2).standard_normal(20), 150),  # ten times as slow as it is asked
        np.round(np.sin(np.arange(3000) / 100), 1),  # coarse
    ],
    ids=["at rest", "slow", "coarse"],
)
def test_a_gyro_that_repeats_what_it_measures_does_not_hang(rates: np.ndarray) -> None:
    gyro = Gyro(SyncConfig())
    gyro.add(np.arange(3000) / 100, rates[:, None])
    assert not gyro.hung
    assert len(gyro) == 3000
    assert about_hanging(gyro.hung) == ()
