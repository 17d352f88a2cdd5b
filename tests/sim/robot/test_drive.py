"""The robot in the physics engine: it goes where its wheels and the walls let it, not where it was commanded."""

from typing import Any

import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import Scenario, parse_scenario
from moteslam.sim.simulate import simulate, true_drive
from moteslam.sim.world.world import World


def commanded(table: dict[str, Any], *steps: dict[str, float], start: tuple[float, float, float]) -> Scenario:
    table = {key: value for key, value in table.items() if key != "route"}
    return parse_scenario({**table, "commands": {"start": list(start), "steps": list(steps)}})


def travel_of_sides(drive: Drive) -> tuple[np.ndarray, np.ndarray]:
    """The travel of the left and right wheels since the start [m]."""
    return drive.wheel_travel[:, [1, 3]].mean(1), drive.wheel_travel[:, [0, 2]].mean(1)


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
    left, right = travel_of_sides(run)
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
    with pytest.raises(ConfigError, match=r"the robot got stuck near \(4\.") as caught:
        simulate(stuck)
    assert caught.value.field == "route"


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
    with pytest.raises(ConfigError, match="no free leg") as caught:
        true_drive(parse_scenario(table))
    assert caught.value.field == "wander"


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
