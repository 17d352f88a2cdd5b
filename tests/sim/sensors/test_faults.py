"""Lost messages, dead sensors, wrong clocks, wheels that are not what they should be."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from ucsd_robot import ENCODERS, WHEELS

from moteslam.errors import ConfigError
from moteslam.robot.noise import ClockNoise, EncoderNoise, Noise
from moteslam.robot.recording import EncoderStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import Outage, with_faults
from moteslam.sim.sensors.encoders import simulate_encoders
from moteslam.sim.simulate import EPOCH, Simulation, simulate


def stream(n: int = 10_000) -> EncoderStream:
    return EncoderStream(np.arange(n) / 40.0, np.arange(4 * n).reshape(n, 4))


def test_a_share_of_the_messages_is_lost_whole() -> None:
    kept = with_faults(stream(), ClockNoise(lost=0.2), [], np.random.default_rng(0))
    assert len(kept) / 10_000 == pytest.approx(0.8, abs=0.02)
    index = np.round(kept.stamps * 40).astype(int)
    np.testing.assert_array_equal(kept.counts[:, 0], 4 * index)  # each stamp has its own counts


def test_a_dead_sensor_is_silent_and_comes_back() -> None:
    outages = [
        Outage(sensor="encoders", start=10.0, duration=5.0),
        Outage(sensor="encoders", start=200.0, duration=99.0),
    ]
    kept = with_faults(stream(), ClockNoise(), outages, np.random.default_rng(0))
    assert len(kept) == 10_000 - 200 - 99 * 40 + (299 - 250) * 40
    assert not ((kept.stamps >= 10.0) & (kept.stamps < 15.0)).any()
    assert 15.0 in kept.stamps


def test_a_clock_that_is_off_and_drifts() -> None:
    moved = with_faults(stream(), ClockNoise(offset=-0.5, drift=1e-3), [], np.random.default_rng(0))
    np.testing.assert_allclose(moved.stamps, stream().stamps * 1.001 - 0.5)


def test_without_faults_nothing_is_drawn_and_nothing_changes() -> None:
    rng, before = np.random.default_rng(0), stream()
    assert with_faults(before, ClockNoise(), [], rng) is before
    assert rng.random() == np.random.default_rng(0).random()


def straight(speed: float = 0.5, duration: float = 60.0) -> Drive:
    stamps = np.arange(round(duration * 400) + 1) / 400
    poses = np.stack((speed * stamps, 0 * stamps, 0 * stamps), axis=-1)
    return Drive(stamps, poses, np.zeros_like(poses), np.tile(speed * stamps[:, None], (1, 4)), "arrived")


def travelled(**changed: Any) -> np.ndarray:
    """What the four counters make of 29.5 m [m]."""
    noise = EncoderNoise(**changed)
    found = simulate_encoders(straight(), WHEELS, ENCODERS, noise, 0.0, (0.5, 59.5), np.random.default_rng(0))
    return found.counts.sum(0) * WHEELS.metres_per_count


def test_wheels_that_are_too_large_turn_less() -> None:
    np.testing.assert_allclose(travelled(), 29.5, atol=0.01)
    np.testing.assert_allclose(travelled(radius_factors=(1.0, 1.1, 1.0, 0.9)) * (1.0, 1.1, 1.0, 0.9), 29.5, atol=0.01)


def test_missed_ticks_are_missed() -> None:
    np.testing.assert_allclose(travelled(missed=0.1), 0.9 * 29.5, rtol=0.01)


def test_slip_bursts_turn_the_wheels_of_one_side_at_a_time_further() -> None:
    fr, fl, rr, rl = travelled(bursts=20.0, burst_slip=1.0, burst_time=0.5)
    assert fr == pytest.approx(rr, abs=0.01)
    assert fl == pytest.approx(rl, abs=0.01)
    more = (fr - 29.5) + (fl - 29.5)
    assert more == pytest.approx(20 * 0.5 * 0.5, rel=0.6)  # 20 bursts of half a second at 0.5 m/s
    assert fr != fl


@pytest.fixture
def plain(table: dict[str, Any], taichi: None) -> Simulation:
    return simulate(parse_scenario({**table, "noise": Noise().model_dump()}), seed=2)


def test_faults_of_one_sensor_leave_the_others_and_the_truth_as_they_were(
    table: dict[str, Any], plain: Simulation
) -> None:
    noise = Noise().model_dump()
    noise["lidar"]["clock"]["lost"] = 0.3
    noise["lidar"]["clock"]["offset"] = 0.25
    outages = [{"sensor": "lidar", "start": 2.0, "duration": 1.5}]
    faulty = simulate(parse_scenario({**table, "noise": noise, "outages": outages}), seed=2)
    assert faulty.truth.poses.tobytes() == plain.truth.poses.tobytes()
    ours, theirs = faulty.recording, plain.recording
    assert ours.encoders is not None and theirs.encoders is not None  # noqa: PT018
    assert ours.lidar is not None and theirs.lidar is not None  # noqa: PT018
    assert ours.encoders.counts.tobytes() == theirs.encoders.counts.tobytes()
    at = np.searchsorted(theirs.lidar.stamps, ours.lidar.stamps - 0.25 - 1e-6)
    np.testing.assert_array_equal(ours.lidar.ranges, theirs.lidar.ranges[at])
    silent = ours.lidar.stamps - EPOCH - 0.25
    assert not ((silent > 2.0) & (silent < 3.5)).any()
    assert len(ours.lidar) < 0.8 * len(theirs.lidar)


def test_grip_patches_make_the_robot_slip(table: dict[str, Any], taichi: None) -> None:
    table["world"]["slippery"] = [{"corner": [3.0, 0.0], "size": [7.0, 8.0], "grip": 0.02}]
    from moteslam.sim.simulate import true_drive

    dry = true_drive(parse_scenario({**table, "world": {"rooms": table["world"]["rooms"]}}))
    wet = true_drive(parse_scenario(table))
    slip = [run.wheel_travel[-1].mean() - run.truth.length for run in (dry, wet)]
    assert abs(slip[0]) < 0.3
    assert slip[1] > 1.0


@pytest.mark.parametrize(
    ("key", "value", "field"),
    [
        ("outages", [{"sensor": "sonar", "start": 1.0, "duration": 1.0}], "outages.0.sensor"),
        ("outages", [{"sensor": "lidar", "start": 1.0, "duration": 0.0}], "outages.0.duration"),
        ("noise", {"lidar": {"clock": {"drift": 1.0}}}, "noise.lidar.clock.drift"),
        ("noise", {"encoders": {"radius_factors": [1.0, 1.0]}}, "noise.encoders.radius_factors"),
    ],
)
def test_refused(table: dict[str, Any], key: str, value: Any, field: str) -> None:
    with pytest.raises(ConfigError) as caught:
        parse_scenario({**table, key: value}, file="my.toml")
    assert str(caught.value.field).startswith(field)
    assert "\n" not in str(caught.value)
