"""The robot in the physics engine goes where wheels and walls let it; wheels that spin, and a robot that is carried."""

import math
from typing import Any

import numpy as np
import pytest
from box_ranges import box_ranges
from refusals import refusal
from sim_drives import room_table

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.noise import Noise
from moteslam.robot.platforms import UCSD
from moteslam.sim.robot.drive import Drive
from moteslam.sim.robot.vehicle import Vehicle
from moteslam.sim.scenario import Scenario, parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation, simulate, true_drive
from moteslam.sim.world.world import World


def with_commands(table: dict[str, Any], *steps: dict[str, float], start: tuple[float, ...]) -> dict[str, Any]:
    """The same with commands in place of the route."""
    without = {key: value for key, value in table.items() if key != "route"}
    return {**without, "commands": {"start": list(start), "steps": list(steps)}}


def test_wheels_that_spin_turn_as_they_are_asked_to() -> None:
    vehicle = Vehicle(UCSD, np.zeros(3), World.of(parse_scenario(room_table()).world), Noise().drive)
    for _ in range(400):
        vehicle.spin(0.5, 0.8)
    right, left = 0.5 + 0.8 * 0.73 / 2, 0.5 - 0.8 * 0.73 / 2
    assert vehicle.state() == pytest.approx((0, 0, 0, 0, 0, 0, right, left, right, left))


def commanded(table: dict[str, Any], *steps: dict[str, float], start: tuple[float, ...]) -> Scenario:
    return parse_scenario(with_commands(table, *steps, start=start))


def test_it_rests_drives_and_rests(scenario: Scenario) -> None:
    run = true_drive(scenario)
    assert run.end == "arrived"
    resting = run.stamps <= 1.0
    np.testing.assert_array_equal(run.poses[resting], np.broadcast_to((2.0, 2.0, 0.0), (resting.sum(), 3)))
    np.testing.assert_allclose(run.velocities[-400:], 0, atol=1e-4)
    assert np.hypot(*(run.poses[-1, :2] - (7.0, 6.0))) < 0.3
    assert np.diff(run.stamps) == pytest.approx(1 / 400)
    summed = run.poses[0] + np.cumsum(run.velocities[:-1] / 400, axis=0)
    np.testing.assert_allclose(run.poses[1:], summed, atol=1e-9)
    assert run.poses.tobytes() == true_drive(scenario).poses.tobytes() != true_drive(scenario, 2).poses.tobytes()


@pytest.mark.parametrize("rate", [-1.0, 0.3, 1.2])
def test_turning_on_the_spot_takes_the_effective_track(table: dict[str, Any], rate: float) -> None:
    run = true_drive(commanded(table, {"duration": 10.0, "turn_rate": rate}, start=(5.0, 4.0, 0.0)))
    left, right = (run.wheel_travel[:, side].mean(axis=1) for side in ([1, 3], [0, 2]))
    turned = run.poses[-1, 2] - run.poses[0, 2]
    assert (right[-1] - left[-1]) / turned == pytest.approx(0.73, rel=0.02)
    assert turned == pytest.approx(rate * 10.0, rel=0.06)  # what is lost in starting


def test_against_a_wall_the_robot_stops_and_its_wheels_turn_on(table: dict[str, Any]) -> None:
    run = true_drive(commanded(table, {"duration": 10.0, "speed": 0.8}, start=(7.0, 4.0, 0.0)))
    assert run.poses[-1, 0] == pytest.approx(10.0 - 0.5842 / 2, abs=0.02)
    pushing = (run.stamps > 6.0) & (run.stamps < 10.0)
    assert np.abs(run.velocities[pushing, :2]).max() < 0.02
    assert (np.ptp(run.wheel_travel[pushing], axis=0) > 2.5).all()
    weak = {**table, "platform": {"base": "ucsd", "body": {"wheel_force": 5.0}}}
    run = true_drive(commanded(weak, {"duration": 10.0, "speed": 0.8}, start=(7.0, 4.0, 0.0)))
    assert (np.ptp(run.wheel_travel[pushing], axis=0) < 0.3).all()  # too weak a motor stalls


def test_a_robot_that_gets_stuck_says_where(table: dict[str, Any]) -> None:
    # the route leads round a wall with a hook at its end; looking too far ahead, the driver cuts the corner
    table["world"]["walls"] = [{"points": [[5.0, 0.0], [5.0, 2.9], [4.5, 2.9], [4.5, 2.6]]}]
    table["route"]["waypoints"] = [[4.0, 1.0], [4.0, 3.5], [6.0, 3.5], [6.0, 1.0]]
    table["drive"]["lookahead"] = 5.0
    stuck = parse_scenario(table)
    assert true_drive(stuck).end == "stuck"
    with refusal(ConfigError, r"the robot got stuck near \(4\.", field="route"):
        simulate(stuck)


def test_a_wander_keeps_clear_of_the_walls(table: dict[str, Any]) -> None:
    table["world"]["pillars"] = [{"centre": [5.0, 4.0], "radius": 0.4}]
    del table["route"]
    table["wander"] = {"start": [2.0, 2.0], "distance": 25.0, "leg": [1.5, 4.0]}
    scenario = parse_scenario(table)
    run = true_drive(scenario)
    assert run.end == "arrived"
    assert run.truth.length > 20.0
    assert World.of(scenario.world).distance(run.poses[::20, :2]).min() > 0.38
    assert true_drive(scenario, 5).poses[-1].tolist() != run.poses[-1].tolist()


def test_a_wander_with_nowhere_to_go_is_refused(table: dict[str, Any]) -> None:
    del table["route"]
    table["wander"] = {"start": [2.0, 2.0], "distance": 25.0, "leg": [20.0, 30.0]}
    with refusal(ConfigError, "no free leg", field="wander"):
        true_drive(parse_scenario(table))


@pytest.mark.parametrize("rate", [-0.5, 0.5])
def test_in_a_bend_the_tyres_give_way_outwards(table: dict[str, Any], rate: float) -> None:
    speed = 0.8
    scenario = commanded(table, {"duration": 8.0, "speed": speed, "turn_rate": rate}, start=(5.0, 4.0, 0.0))
    run = true_drive(scenario)
    steady = (run.stamps > 4.0) & (run.stamps < 8.5)
    (vx, vy, turn_rate), heading = run.velocities[steady].T, run.poses[steady, 2]
    forward, left = np.cos(heading) * vx + np.sin(heading) * vy, np.cos(heading) * vy - np.sin(heading) * vx
    # four tyres of this sideways stiffness carry the centripetal force m v w
    wheels, body = scenario.platform.wheels, scenario.platform.body
    sideways = body.stiffness * (wheels.effective_track - wheels.track) * wheels.track / wheels.wheel_base**2
    expected = -body.mass * forward * turn_rate / (4 * sideways)
    assert np.abs(expected).min() > 0.01
    np.testing.assert_allclose(left, expected, rtol=0.05)


def test_rolling_resistance_turns_the_wheels_further_than_the_robot_drives(table: dict[str, Any]) -> None:
    def slipped(resistance: float) -> float:
        noise = {"drive": {"rolling_resistance": resistance}}
        run = true_drive(commanded({**table, "noise": noise}, {"duration": 6.0, "speed": 0.8}, start=(2.0, 4.0, 0.0)))
        return float(run.wheel_travel[-1].mean() - run.truth.length)

    expected = 0.02 * 20.0 * 9.80665 / (4 * 100.0) * 6.0  # the slip that carries the force, for 6 s
    assert slipped(0.02) - slipped(0.0) == pytest.approx(expected, rel=0.1)


def test_load_moves_to_the_outer_wheels_in_a_bend(table: dict[str, Any]) -> None:
    def distance(height: float) -> float:
        noise = {"drive": {"mass_height": height}}
        steps = {"duration": 8.0, "speed": 0.8, "turn_rate": 0.8}
        run = true_drive(commanded({**table, "noise": noise}, steps, start=(5.0, 4.0, 0.0)))
        return float(run.truth.length / run.wheel_travel[-1].mean())

    # the outer wheels turn further, and hold more: the robot drives further than its wheels on average
    assert distance(0.3) > distance(0.0) * 1.002


START, DURATION = 4.0, 5.0


def run(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Simulation:
    return simulate(parse_scenario({**table, "noise": Noise().model_dump(), **changes, "faults": list(faults)}), seed=2)


def driven(table: dict[str, Any], *faults: dict[str, Any], **changes: Any) -> Drive:
    return true_drive(parse_scenario({**table, **changes, "faults": list(faults)}), seed=2)


def mishap(kind: str, **keys: Any) -> dict[str, Any]:
    return {"kind": kind, "start": START, "duration": DURATION, **keys}


def blind(table: dict[str, Any]) -> dict[str, Any]:
    return with_commands(table, {"duration": 4.0, "speed": 0.5}, start=(2.0, 2.0, 0.0))


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
        assert scans.ranges[i, 540] == pytest.approx(box_ranges(x, y, theta, (0.0, 0.0), (10.0, 8.0)), abs=0.05)


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
        with refusal(ConfigError, field=field):
            driven(task, *faults)
