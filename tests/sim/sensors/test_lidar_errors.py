"""What is wrong with one lidar over a recording, bias, scale, mount, tilt and clock: each shows when it is on."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from moteslam.robot import se2
from moteslam.robot.noise import LidarNoise
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.lidar import LidarErrors, tilted
from moteslam.sim.simulate import Simulation, simulate

STEPS = [{"duration": 3.0, "speed": 0.5, "turn_rate": 0.4}]


def recorded(table: dict[str, Any], seed: int, drive: dict[str, float] | None = None, **lidar: Any) -> Simulation:
    """A short drive with the LMS200, whose only errors are these."""
    task = {key: value for key, value in table.items() if key != "route"}
    task["commands"] = {"start": [3.0, 3.0, 0.0], "steps": STEPS}
    base = parse_scenario({**task, "platform": "lms200"}).platform
    perfect = base.model_copy(update={"noise": base.noise.model_validate({"lidar": lidar, "drive": drive or {}})})
    return simulate(parse_scenario({**task, "platform": perfect}), seed)


def ranges(simulation: Simulation) -> np.ndarray:
    assert simulation.recording.lidar is not None
    return simulation.recording.lidar.ranges


@pytest.fixture
def plain(table: dict[str, Any], taichi: None) -> Simulation:
    return recorded(table, 1)


@pytest.mark.usefixtures("taichi")
def test_a_bias_is_the_same_on_all_ranges_and_another_in_every_recording(
    table: dict[str, Any], plain: Simulation
) -> None:
    off = [ranges(recorded(table, seed, range_bias=0.1)) - ranges(recorded(table, seed)) for seed in (1, 2)]
    assert max(np.ptp(one) for one in off) < 1e-4
    assert abs(off[0].mean()) > 0.001
    assert abs(off[0].mean() - off[1].mean()) > 0.001


def test_a_scale_error_grows_with_the_range(table: dict[str, Any], plain: Simulation) -> None:
    factor = ranges(recorded(table, 1, range_scale_error=0.05)) / ranges(plain)
    assert np.ptp(factor) < 1e-4
    assert abs(factor.mean() - 1) > 0.001


def test_a_mount_error_moves_the_lidar_as_far_as_it_is_drawn(table: dict[str, Any], plain: Simulation) -> None:
    simulation = recorded(table, 1, mount_error=0.1, mount_yaw_error=0.1)
    lidar = simulation.recording.lidar
    assert lidar is not None
    assert simulation.recording.platform.lidar == plain.recording.platform.lidar  # the recording does not know of it
    spread = [
        LidarErrors.drawn(LidarNoise(mount_error=0.1, mount_yaw_error=0.1), np.random.default_rng(i))
        for i in range(400)
    ]
    assert np.std([one.x for one in spread]) == pytest.approx(0.1, rel=0.1)
    assert np.std([one.y for one in spread]) == pytest.approx(0.1, rel=0.1)
    assert np.std([one.yaw for one in spread]) == pytest.approx(0.1, rel=0.1)

    # the endpoints lie on the walls from where the lidar truly is, and only from there
    def away(mount: tuple[float, float, float]) -> float:
        at = np.searchsorted(simulation.truth.stamps, lidar.stamps[0])
        pose = se2.compose(simulation.truth.poses[at], np.array(mount))
        angles = pose[2] + lidar.angles
        ends = pose[:2] + lidar.ranges[0][:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        return float(simulation.world.distance(ends).mean())

    x, y, yaw = simulation.scenario.platform.lidar.pose
    assert away((x, y, yaw)) > 0.01
    from scipy.optimize import minimize

    best = minimize(lambda mount: away(tuple(mount)), (x, y, yaw), method="Nelder-Mead", options={"maxiter": 2000})
    assert best.fun < 1e-3
    assert np.hypot(best.x[0] - x, best.x[1] - y) > 0.02


def test_a_clock_offset_is_another_in_every_recording(table: dict[str, Any], plain: Simulation) -> None:
    late = [recorded(table, seed, clock={"offset_error": 0.1}).recording.lidar for seed in (1, 2)]
    exact = [recorded(table, seed).recording.lidar for seed in (1, 2)]
    off = [np.asarray(a.stamps - b.stamps) for a, b in zip(late, exact, strict=True) if a is not None and b is not None]
    assert max(np.ptp(one) for one in off) < 1e-6
    assert abs(off[0][0]) > 0.005
    assert abs(off[0][0] - off[1][0]) > 0.005


@pytest.mark.parametrize("errors", [{"mount_tilt_error": 0.1}, {"drive": {"sway": 0.1}}, {"drive": {"shake": 0.1}}])
def test_a_lidar_that_tilts_measures_further_or_loses_beams_on_the_floor(
    table: dict[str, Any], plain: Simulation, errors: dict[str, Any]
) -> None:
    tilted_ranges, level = ranges(recorded(table, 1, **errors)), ranges(plain)
    assert np.isinf(tilted_ranges).any()
    seen = np.isfinite(tilted_ranges)
    assert (tilted_ranges[seen] >= level[seen] - 1e-4).all()
    assert (tilted_ranges[seen] > level[seen] + 1e-3).any()
    assert recorded(table, 1, **errors).truth.poses.tobytes() == plain.truth.poses.tobytes()


def test_a_beam_that_dips_is_longer_until_it_ends_on_the_floor() -> None:
    level = np.array([5.0, 50.0, 5.0, 5.0, np.inf, np.nan], np.float32)
    bearings = np.array([0.0, 0.0, np.pi, np.pi / 2, 0.0, 0.0])
    found = tilted(level, np.array((0.0, 0.02)), bearings, 0.4)  # 2 cm down a metre: the floor is 20 m away
    assert found[0] == pytest.approx(5.0 / np.cos(0.02), abs=1e-6)
    assert np.isposinf(found[1])
    assert found[2] == pytest.approx(5.0 / np.cos(0.02), abs=1e-6)  # backwards it looks up
    assert found[3] == pytest.approx(5.0)
    assert np.isposinf(found[4])
    assert np.isnan(found[5])
    rolled = tilted(np.full(2, 50.0, np.float32), np.array((0.02, 0.0)), np.array((-np.pi / 2, np.pi / 2)), 0.4)
    assert np.isposinf(rolled[0])  # to the right it looks down
    assert np.isfinite(rolled[1])
    assert np.isfinite(tilted(level[1:2], np.array((0.0, 0.02)), bearings[1:2], 0.0)).all()
