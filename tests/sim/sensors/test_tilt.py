"""Bodies that lean, dip and shake."""

from __future__ import annotations

import numpy as np
import pytest
from sim_drives import steady

from moteslam.robot.noise import DriveNoise
from moteslam.sim.robot.drive import Drive
from moteslam.sim.sensors.lidar import tilt_of


def test_a_body_dips_when_it_brakes_and_rises_when_it_speeds_up() -> None:
    stamps = np.arange(2001) / 400
    speed = np.where(stamps < 2.5, stamps, 5 - stamps)  # 1 m/s^2 up, then down
    zeros = np.zeros_like(stamps)
    poses = np.stack((np.cumsum(speed) / 400, zeros, zeros), axis=1)
    drive = Drive(stamps, poses, np.stack((speed, zeros, zeros), axis=1), np.zeros((2001, 4)), "arrived")
    roll, pitch = tilt_of(drive, DriveNoise(sway=0.02), np.random.default_rng(0)).T
    assert pitch[900] == pytest.approx(-0.02, rel=0.01)
    assert pitch[1900] == pytest.approx(0.02, rel=0.01)
    assert not roll.any()


def test_a_body_leans_out_of_a_bend() -> None:
    stamps = np.arange(2001) / 400
    heading = stamps  # to the left, 1 rad/s at 1 m/s: 1 m/s^2 to the left
    velocities = np.stack((np.cos(heading), np.sin(heading), np.ones_like(heading)), axis=1)
    poses = np.stack((np.sin(heading), 1 - np.cos(heading), heading), axis=1)
    drive = Drive(stamps, poses, velocities, np.zeros((2001, 4)), "arrived")
    roll, pitch = tilt_of(drive, DriveNoise(sway=0.02), np.random.default_rng(0)).T
    assert roll[1000] == pytest.approx(0.02, rel=0.01)  # to the right
    assert abs(pitch[1000]) < 1e-3


def test_it_shakes_with_its_speed_and_not_at_rest() -> None:
    noise = DriveNoise(shake=0.01)
    driving = tilt_of(steady(60.0, speed=0.5), noise, np.random.default_rng(0))
    assert driving.std(axis=0) == pytest.approx(0.005, rel=0.15)
    correlation = np.corrcoef(driving[:-40, 0], driving[40:, 0])[0, 1]
    assert correlation == pytest.approx(np.exp(-1), abs=0.15)
    assert not tilt_of(steady(5.0), noise, np.random.default_rng(0)).any()
