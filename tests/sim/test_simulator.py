"""The robot in closed loop: what arrives when, the same as of a recording, and a controller of ten lines."""

import numpy as np
import pytest
from closed_loop import WANTED, controller

from moteslam.errors import ConfigError
from moteslam.sim.robot.driver import driver_for
from moteslam.sim.scenario import Scenario, load_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.simulate import Sensors, random_generators, simulate
from moteslam.sim.simulator import Simulator
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")


def short(seconds: float, name: str = "corridor") -> Scenario:
    return load_scenario(name).model_copy(update={"duration": seconds})


def test_a_controller_of_ten_lines_follows_a_wall():
    simulator = Simulator(short(40.0), seed=0)
    readings, command, apart = simulator.reset(), (0.0, 0.0), list[float]()
    while not simulator.done:
        if len(readings.lidar):
            command = controller(readings)
        readings = simulator.step(*command)
        apart.append(float(simulator.world.distance(simulator.pose[None, :2])[0]))
    assert simulator.truth.length > 12
    assert np.median(apart[500:]) == pytest.approx(WANTED, abs=0.1)
    assert min(apart) > simulator.scenario.platform.width / 2


@pytest.mark.parametrize("name", ["corridor", "doors"])
def test_the_bundled_driver_drives_it_to_the_bytes_of_simulate(name: str):
    scenario = short(20.0, name)
    simulator, rngs = Simulator(scenario, seed=3), random_generators(3)
    driver = driver_for(scenario.task, scenario.drive, World.of(scenario.world), rngs["driver"])
    rest = round(scenario.drive.rest_start / simulator.interval)
    for step in range(rest + 400):
        pose = tuple(simulator._run.state[:3])
        command = driver.command((step - rest) * simulator.interval, *pose) if step >= rest else (0.0, 0.0)
        assert command is not None
        simulator.step(*command)
    truth, whole = simulator.truth, simulate(scenario, seed=3).truth
    assert truth.poses.tobytes() == whole.poses[: len(truth)].tobytes()
    assert truth.stamps.tobytes() == whole.stamps[: len(truth)].tobytes()


def test_readings_come_at_each_sensors_own_rate_and_no_earlier_than_they_are_taken():
    simulator = Simulator(short(8.0), seed=1)
    again = Simulator(short(8.0), seed=1)
    counts = dict.fromkeys(("lidar", "encoders", "imu"), 0)
    while not simulator.done:
        readings, same = simulator.step(0.4, 0.1), again.step(0.4, 0.1)
        for name in counts:
            stream, other = getattr(readings, name), getattr(same, name)
            counts[name] += len(stream)
            assert (stream.stamps <= readings.stamp).all()
            assert stream.stamps.tobytes() == other.stamps.tobytes()
            if name == "lidar":
                assert stream.ranges.tobytes() == other.ranges.tobytes()
    platform = simulator.scenario.platform
    for name in counts:
        spec = platform.lidar.scan if name == "lidar" else getattr(platform, name)
        assert counts[name] == pytest.approx(7.0 * spec.rate, rel=0.2)
    begun = simulator.reset()
    assert not any(len(getattr(begun, name)) for name in counts)
    assert begun.stamp == EPOCH
    np.testing.assert_array_equal(simulator.pose, simulator.scenario.start)


DEAD = [{"sensor": sensor, "start": 3.0 + k, "duration": 2.5} for k, sensor in enumerate(("lidar", "encoders", "imu"))]
SEEN = [{"kind": "cart", "start": 5.0, "duration": 3.0}, {"kind": "tilt", "start": 6.0, "duration": 3.0}]


@pytest.mark.parametrize(
    ("name", "changes"), [("corridor", {}), ("people", {}), ("corridor", {"outages": DEAD, "faults": SEEN})]
)
def test_what_is_read_in_pieces_is_what_is_read_at_once(name: str, changes: dict):
    scenario = short(12.0, name).with_(**changes)
    simulator = Simulator(scenario, seed=2)
    for _ in range(500):
        simulator.step(0.3, 0.0)
    rngs, pieces = random_generators(2), random_generators(2)
    driven, scene = simulator._run.driven(), Scene(World.of(scenario.world))
    scene = scene.moved(driven.tracks)
    one, parts = Sensors(scenario, 10.0, rngs), Sensors(scenario, 10.0, pieces)
    lidar, encoders, imu = one.read(driven, scene)
    read = [parts.read(driven, scene, until) for until in (0.05, 2.0, 2.02, 7.7, np.inf)]
    assert imu is not None
    for stream, field in ((0, "stamps"), (1, "stamps"), (1, "counts"), (2, "stamps"), (2, "angular_velocity")):
        joined = np.concatenate([getattr(part[stream], field) for part in read])
        assert joined.tobytes() == getattr((lidar, encoders, imu)[stream], field).tobytes(), field
    ranges = np.concatenate([part[0].ranges for part in read])
    known = np.isfinite(ranges) & np.isfinite(lidar.ranges)
    off = np.abs(ranges[known] - lidar.ranges[known])
    assert np.percentile(off, 95) < 0.1


@pytest.mark.parametrize("field", ["faults", "noise.surroundings"])
def test_what_needs_the_whole_drive_is_refused(field: str):
    gap = [{"kind": "gap", "start": 12.0, "duration": 2.0}]
    scenario = load_scenario("corridor", noise="as_recorded") if field != "faults" else short(40.0).with_(faults=gap)
    with pytest.raises(ConfigError) as caught:
        Simulator(scenario)
    assert caught.value.field == field


def test_commands_that_are_no_numbers_and_steps_after_the_end_are_refused():
    simulator = Simulator(short(12.0))
    with pytest.raises(ConfigError) as caught:
        simulator.step(np.nan, 0.0)
    assert caught.value.field == "speed"
    while not simulator.done:
        simulator._run.step()
    with pytest.raises(ConfigError) as caught:
        simulator.step(0.0, 0.0)
    assert caught.value.field == "duration"
