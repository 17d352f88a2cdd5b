"""Complete simulations: reproducible, consistent with their truth, and the same when read back from disk."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from sim_drives import room_table

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.formats.ucsd import read_ucsd
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.output import write_simulation
from moteslam.sim.scenario import Scenario, load_scenario, parse_scenario
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.simulate import Simulation, simulate

pytestmark = pytest.mark.usefixtures("taichi")


def arrays(recording: Recording) -> dict[str, np.ndarray]:
    """Every array of a recording by its name."""
    found = {}
    for stream in ("lidar", "encoders", "imu"):
        part = getattr(recording, stream)
        for field in dataclasses.fields(part):
            if isinstance(value := getattr(part, field.name), np.ndarray):
                found[f"{stream}.{field.name}"] = value
    return found


def identical(a: Recording, b: Recording) -> bool:
    first, second = arrays(a), arrays(b)
    return first.keys() == second.keys() and all(
        first[name].tobytes() == second[name].tobytes() and first[name].dtype == second[name].dtype for name in first
    )


@pytest.fixture(scope="module")
def simulation(taichi: None) -> Simulation:
    return simulate(parse_scenario(room_table()), seed=4)


def test_the_same_seed_gives_the_same_bytes(scenario: Scenario, simulation: Simulation) -> None:
    again, other = simulate(scenario, seed=4), simulate(scenario, seed=5)
    assert identical(simulation.recording, again.recording)
    assert simulation.truth.poses.tobytes() == again.truth.poses.tobytes()
    ours, others = arrays(simulation.recording), arrays(other.recording)
    for name in ours:
        assert ours[name].tobytes() != others[name].tobytes(), name


def test_the_seed_is_the_scenarios_where_none_is_given(scenario: Scenario, simulation: Simulation) -> None:
    assert identical(simulate(scenario.model_copy(update={"seed": 4})).recording, simulation.recording)
    assert simulation.scenario.seed == 4
    zero = simulate(scenario.model_copy(update={"seed": 4}), seed=0)
    assert zero.scenario.seed == 0
    assert not identical(zero.recording, simulation.recording)
    with pytest.raises(ConfigError) as caught:
        simulate(scenario, seed=-1)
    assert caught.value.field == "seed"


def test_streams_start_and_end_as_on_the_real_robot(simulation: Simulation) -> None:
    lidar, encoders, imu = (getattr(simulation.recording, name) for name in ("lidar", "encoders", "imu"))
    assert simulation.truth.stamps[0] == EPOCH
    assert 0.28 < imu.stamps[0] - encoders.stamps[0] < 0.52
    assert 1.3 < encoders.stamps[-1] - imu.stamps[-1] < 1.7
    assert encoders.stamps[0] < lidar.stamps[0]
    assert lidar.stamps[-1] < encoders.stamps[-1] < simulation.truth.stamps[-1]


def test_scans_seen_from_the_truth_end_on_the_walls(simulation: Simulation) -> None:
    lidar, platform = simulation.recording.lidar, simulation.recording.platform
    times = lidar.stamps[::20, None] + platform.lidar.time_increment * np.arange(1081)
    robot = simulation.truth.at(times.ravel()).poses.reshape(*times.shape, 3)
    mount = se2.compose(robot, platform.lidar.pose)
    angles = mount[..., 2] + lidar.angles
    ends = mount[..., :2] + lidar.ranges[::20, :, None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)
    finite = np.isfinite(lidar.ranges[::20])
    away = simulation.world.distance(ends[finite])
    assert np.sqrt((away**2).mean()) < 0.015
    assert np.quantile(away, 0.999) < 0.06


def test_a_written_recording_reads_back_identical(simulation: Simulation, tmp_path: Path) -> None:
    write_simulation(tmp_path, simulation, sequence="7")
    back = read_ucsd(tmp_path)
    assert identical(back, simulation.recording)
    assert back.platform == simulation.recording.platform
    assert back.warnings == ()
    for name in ("angle_min", "angle_increment", "range_min", "range_max", "time_increment"):
        assert getattr(back.lidar, name) == getattr(simulation.recording.lidar, name)
    truth = read_tum(tmp_path / "truth.tum")
    assert truth.stamps.tobytes() == simulation.truth.stamps.tobytes()
    np.testing.assert_allclose(truth.poses, simulation.truth.poses, atol=1e-12)
    assert load_scenario(tmp_path / "scenario.toml") == simulation.scenario
