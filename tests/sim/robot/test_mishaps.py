"""Wheels that spin while the robot stands, a robot that is carried: what is true, and what the sensors make of it."""

import math
from typing import Any

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.noise import Noise
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation, simulate, true_drive

START, DURATION = 4.0, 5.0


def run(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Simulation:
    return simulate(parse_scenario({**table, "noise": Noise().model_dump(), **changes, "faults": list(faults)}), seed=2)


def driven(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Drive:
    return true_drive(parse_scenario({**table, **changes, "faults": list(faults)}), seed=2)


def mishap(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "start": START, "duration": DURATION, **keys}


def blind(table: dict[str, Any]) -> dict[str, Any]:
    """The same with commands in place of the route."""
    commands = {"start": [2.0, 2.0, 0.0], "steps": [{"duration": 4.0, "speed": 0.5}]}
    return {**{key: value for key, value in table.items() if key != "route"}, "commands": commands}


def within(stamps: np.ndarray, *, margin: float = 0.0) -> np.ndarray:
    return (stamps >= START + margin) & (stamps < START + DURATION - margin)


@pytest.mark.usefixtures("taichi")
def test_stuck_wheels_count_while_the_robot_stands(table: dict[str, Any]) -> None:
    plain, stuck = run(table), run(table, mishap("stuck_wheels"))
    assert stuck.end == "arrived"
    # the same up to there
    same = stuck.truth.stamps <= EPOCH + START
    assert stuck.truth.poses[same].tobytes() == plain.truth.poses[: same.sum()].tobytes()
    # the truth stands
    held = stuck.truth.poses[within(stuck.truth.stamps - EPOCH, margin=0.02)]
    assert (held == held[0]).all()
    # the encoders count as if it went on at its 0.95 m/s
    encoders, imu, wheels = stuck.recording.encoders, stuck.recording.imu, stuck.scenario.platform.wheels
    counted = encoders.counts[within(encoders.stamps - EPOCH)].sum(0) * wheels.metres_per_count
    assert counted.mean() == pytest.approx(0.95 * DURATION, rel=0.05)
    # the gyro measures no turn
    assert np.abs(imu.angular_velocity[within(imu.stamps - EPOCH, margin=0.05), 2]).max() < 1e-3
    # and the drive goes on, and takes as much longer
    assert stuck.truth.stamps[-1] - plain.truth.stamps[-1] == pytest.approx(DURATION, abs=1.5)
    assert np.hypot(*(stuck.truth.poses[-1] - plain.truth.poses[-1])[:2]) < 0.1


@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("lidar", ["on", "off"])
def test_a_robot_that_is_carried_along_its_path(table: dict[str, Any], lidar: str) -> None:
    plain, carried = run(table), run(table, mishap("carried", along=3.0, lidar=lidar))
    assert carried.end == "arrived"
    same = carried.truth.stamps <= EPOCH + START
    assert carried.truth.poses[same].tobytes() == plain.truth.poses[: same.sum()].tobytes()
    # it is set down 3 m on
    poses, since = carried.truth.poses, carried.truth.stamps - EPOCH
    lifted, down = poses[since <= START][-1], poses[since >= START + DURATION][0]
    path = float(np.abs(lifted[:2] - (7.0, 2.0)).sum())  # to the corner, then up
    expected = (lifted[0] + 3.0, 2.0) if path > 3.0 else (7.0, 2.0 + 3.0 - path)
    np.testing.assert_allclose(down[:2], expected, atol=0.25)
    assert np.abs(np.diff(poses[within(since), :2], axis=0)).max() < 0.02  # it does not leap
    # its wheels do not turn
    encoders, scans, imu = carried.recording.encoders, carried.recording.lidar, carried.recording.imu
    assert not encoders.counts[within(encoders.stamps - EPOCH, margin=0.06)].any()
    # the gyro measures how it is turned
    turning = within(imu.stamps - EPOCH)
    turned = imu.angular_velocity[turning, 2].sum() * 0.01
    assert turned == pytest.approx(se2.wrap(down[2] - lifted[2]), abs=0.05)
    # scans are taken from where it truly is, or not at all
    meanwhile = np.flatnonzero(within(scans.stamps - EPOCH))
    assert len(meanwhile) == (0 if lidar == "off" else pytest.approx(DURATION * 40, abs=2))
    for i in meanwhile[::40]:
        at = scans.stamps[i : i + 1] + scans.time_increment * 540
        x, y, theta = se2.interpolate(carried.truth.stamps, poses, at)[0]
        mount = carried.scenario.platform.lidar
        x, y = x + math.cos(theta) * mount.x, y + math.sin(theta) * mount.x
        cos, sin = math.cos(theta), math.sin(theta)
        walls = [(10.0 - x) / cos if cos > 0 else -x / cos, (8.0 - y) / sin if sin > 0 else -y / sin]
        assert scans.ranges[i, 540] == pytest.approx(min(walls), abs=0.05)


def test_carried_back_it_drives_the_same_path_again(table: dict[str, Any]) -> None:
    plain, carried = driven(table), driven(table, mishap("carried", along=-1.5))
    lifted, down = (carried.poses[carried.stamps >= at][0] for at in (START, START + DURATION))
    np.testing.assert_allclose(down[:2], lifted[:2] - (1.5, 0.0), atol=0.15)
    assert abs(math.remainder(down[2] - lifted[2], math.tau)) < 0.2
    facing = carried.poses[within(carried.stamps, margin=1.5), 2]
    assert np.cos(facing - lifted[2]).max() < -0.9  # who carries it looks ahead
    assert carried.wheel_travel[-1].mean() - plain.wheel_travel[-1].mean() == pytest.approx(1.5, abs=0.3)
    np.testing.assert_allclose(carried.poses[-1, :2], plain.poses[-1, :2], atol=0.1)


def test_carried_to_a_place_it_goes_on_from_the_nearest_of_its_route(table: dict[str, Any]) -> None:
    run = driven(table, mishap("carried", to=[6.0, 5.0, -2.0]))
    down = run.poses[run.stamps >= START + DURATION][0]
    np.testing.assert_allclose((*down[:2], se2.wrap(down[2])), (6.0, 5.0, -2.0), atol=1e-3)
    after = run.poses[run.stamps > START + DURATION]
    assert after[:, 1].min() > 4.5  # never back to where it was lifted
    assert run.end == "arrived"
    assert np.hypot(*(run.poses[-1, :2] - (7.0, 6.0))) < 0.3


@pytest.mark.parametrize(("start", "there"), [(4.0, (7.0, 6.0)), (8.5, (2.0, 2.0))])
def test_by_default_it_is_carried_ten_metres_on_or_back_or_to_an_end(
    table: dict[str, Any], start: float, there: tuple[float, float]
) -> None:
    run = driven(table, mishap("carried", start=start))
    np.testing.assert_allclose(run.poses[run.stamps >= start + DURATION][0, :2], there, atol=0.1)
    assert run.end == "arrived"


def test_a_robot_that_drives_blind_does_the_rest_of_its_commands(table: dict[str, Any]) -> None:
    task = blind(table)
    plain, carried = driven(task), driven(task, mishap("carried", start=3.0, to=[5.0, 6.0, 0.0]))
    assert carried.wheel_travel[-1].mean() == pytest.approx(plain.wheel_travel[-1].mean(), abs=0.4)
    assert carried.poses[-1, 1] == pytest.approx(6.0, abs=0.05)
    assert carried.poses[-1, 0] > 5.8


def test_mishaps_that_cannot_be_are_refused(table: dict[str, Any]) -> None:
    walls = {"rooms": table["world"]["rooms"], "walls": [{"points": [[0.0, 4.0], [5.5, 4.0]]}]}
    below = {**table, "world": walls, "route": {"waypoints": [[2.0, 2.0], [7.0, 2.0]]}}
    for task, faults, field in (
        (table, [mishap("carried", start=8.0), mishap("stuck_wheels")], "faults.0.start"),
        (blind(table), [mishap("carried", along=1.0)], "faults.0.to"),
        (below, [mishap("carried", to=[3.0, 6.0, 0.0])], "faults.0.to"),
        (table, [mishap("carried", along=50.0)], "faults.0.along"),
        (table, [mishap("carried", along=-50.0)], "faults.0.along"),
    ):
        with pytest.raises(ConfigError) as caught:
            driven(task, *faults)
        assert caught.value.field == field
