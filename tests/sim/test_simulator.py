"""Complete simulations, the same when read back from disk; and the robot in closed loop: what arrives when."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from closed_loop import WANTED, controller
from converted import values_of
from refusals import refusal
from sim_drives import room_table

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.formats import open_recording, write_recording
from moteslam.robot.formats.ucsd import read_ucsd
from moteslam.robot.recording import EncoderStream, LidarStream, Recording
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.output import write_simulation
from moteslam.sim.robot.driver import driver_for
from moteslam.sim.scenario import Scenario, load_scenario, parse_scenario, with_camera
from moteslam.sim.sensors.clock import EPOCH
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.sensors.faults import with_gaps, with_odometry_faults, without_lost_motion
from moteslam.sim.sensors.rgbd import Camera
from moteslam.sim.simulate import Sensors, Simulation, random_generators, simulate
from moteslam.sim.simulator import Simulator
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")


def short(seconds: float, name: str = "corridor") -> Scenario:
    return load_scenario(name).model_copy(update={"duration": seconds})


@pytest.mark.slow
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


STUCK = {"faults": [{"kind": "stuck_wheels", "start": 4.0, "duration": 1.0}]}


@pytest.mark.parametrize(
    ("name", "changes"),
    [
        pytest.param("doors", {}, marks=pytest.mark.slow),
        ("corridor", STUCK),
        pytest.param("corridor", {"noise": "as_recorded"}, marks=pytest.mark.slow),
    ],
)
def test_the_bundled_driver_drives_it_to_the_bytes_of_simulate(name: str, changes: dict):
    scenario = load_scenario(name, noise=changes.get("noise")).with_(duration=20.0, faults=changes.get("faults", []))
    simulator, rngs = Simulator(scenario, seed=3), random_generators(3)
    driver = driver_for(scenario.task, scenario.drive, World.of(scenario.world), rngs["driver"])
    rest = round(scenario.drive.rest_start / simulator.interval)
    for step in range(rest + 400):
        pose = tuple(simulator._run.state[:3])
        command = driver.command((step - rest) * simulator.interval, *pose) if step >= rest else (0.0, 0.0)
        simulator.step(*command)
    simulation = simulate(scenario, seed=3)
    truth, whole = simulator.truth, simulation.truth
    assert simulator.world.segments.tobytes() == simulation.world.segments.tobytes()
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


def test_a_drive_in_closed_loop_is_written_as_a_recording_and_read_back(tmp_path: Path):
    simulator = Simulator(short(8.0), seed=1)
    readings = [simulator.reset()]
    while not simulator.done:
        readings.append(simulator.step(0.4, 0.1))
    recording = simulator.recording(readings)
    assert len(recording.lidar) == sum(len(each.lidar) for each in readings)
    assert (np.diff(recording.lidar.stamps) > 0).all()
    write_recording(tmp_path / "drive", recording, to="ucsd")
    back = open_recording(tmp_path / "drive")
    for (name, one), (_, other) in zip(values_of(back), values_of(recording), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-6, err_msg=name)


DEAD = [{"sensor": sensor, "start": 3.0 + k, "duration": 2.5} for k, sensor in enumerate(("lidar", "encoders", "imu"))]
SEEN = [{"kind": "cart", "start": 5.0, "duration": 3.0}, {"kind": "tilt", "start": 6.0, "duration": 3.0}]
LOGGED = [
    {"kind": "gap", "start": 2.5, "duration": 1.0},
    {"kind": "gap", "start": 4.0, "duration": 1.0, "counters": "lost"},
    {"kind": "odometry_jump", "start": 5.5, "x": 0.4, "theta": 0.2},
    {"kind": "stale_odometry", "start": 6.0, "duration": 1.5},
    {"kind": "repeated_scans", "start": 8.0, "duration": 1.0},
]


def by_steps(simulator: Simulator, steps: int) -> dict[str, list[Any]]:
    """All readings of a drive, by their streams."""
    found: dict[str, list[Any]] = {name: [] for name in ("lidar", "encoders", "imu", "rgbd")}
    for _ in range(steps):
        readings = simulator.step(0.3, 0.1)
        for name, streams in found.items():
            streams.append(getattr(readings, name))
    return found


def test_faults_of_the_log_are_in_the_readings_as_in_a_recording():
    scenario = short(11.0)
    found, plain = (by_steps(Simulator(scenario.with_(faults=some), seed=2), 500) for some in (LOGGED, []))
    stamps, counts, right_stamps, right = (
        np.concatenate([getattr(one, field) for one in streams["encoders"]])
        for streams in (found, plain)
        for field in ("stamps", "counts")
    )
    wheels = EncoderStream(right_stamps, right)
    lidar = LidarStream(right_stamps[:0], np.empty((0, 1), np.float32), 0.0, 0.1, 0.1, 9.0)
    faults = scenario.with_(faults=LOGGED).faults
    base = without_lost_motion(Recording("all", scenario.platform, lidar=lidar, encoders=wheels), faults)
    expected = with_odometry_faults(with_gaps(base, faults), faults).encoders
    assert stamps.tobytes() == expected.stamps.tobytes()
    assert counts.tobytes() == expected.counts.tobytes() != right.tobytes()
    for name in ("lidar", "imu"):
        times = np.concatenate([one.stamps for one in found[name]]) - EPOCH
        assert not ((times >= 2.5) & (times < 3.5)).any()
    scans = [one for one in found["lidar"] if len(one) and 8.1 < one.stamps[0] - EPOCH < 8.9]
    assert len({one.ranges[-1].tobytes() for one in scans}) == 1 < len(scans)


def test_a_robot_that_is_carried_goes_on_where_it_was_set_down():
    carried = {"kind": "carried", "start": 2.0, "duration": 2.0, "to": [6.0, 0.0, 0.5]}
    simulator = Simulator(short(12.0).with_(faults=[carried]))
    by_steps(simulator, 200)
    np.testing.assert_allclose(simulator.pose, carried["to"], atol=1e-9)
    by_steps(simulator, 100)
    assert 0.2 < np.hypot(*(simulator.pose - carried["to"])[:2]) < 1.0


def test_images_come_at_the_cameras_own_rate_from_where_the_robot_is():
    scenario = with_camera(short(4.0, "people"))
    simulator = Simulator(scenario, seed=2)
    frames = [one for one in by_steps(simulator, 200)["rgbd"] if len(one.rgb_stamps)]
    stamps = np.concatenate([one.rgb_stamps for one in frames])
    assert len(stamps) == pytest.approx(2.0 * scenario.camera.rate, rel=0.3)  # it loses some
    assert (np.diff(stamps) > 0).all()
    camera = Camera(scenario.platform.camera, scenario.camera, scenario.floor, 4.0, 2)
    driven = simulator._run.driven()
    whole = camera.read(driven, Scene(simulator.world, driven.tracks))
    assert whole.rgb.stamps[: len(stamps)].tobytes() == stamps.tobytes()
    apart = whole.draw_rgb(np.array([len(stamps) - 1]))[0].astype(int) - frames[-1].images.rgb(-1)
    assert frames[-1].images.disparity(0).shape == (480, 640)
    assert np.abs(apart).mean() < 3


@pytest.mark.slow
@pytest.mark.parametrize(("name", "changes"), [("people", {}), ("corridor", {"outages": DEAD, "faults": SEEN})])
def test_what_is_read_in_pieces_is_what_is_read_at_once(name: str, changes: dict):
    scenario = short(12.0, name).with_(**changes)
    simulator = Simulator(scenario, seed=2)
    for _ in range(500):
        simulator.step(0.3, 0.0)
    rngs, pieces = random_generators(2), random_generators(2)
    driven = simulator._run.driven()
    scene = Scene(World.of(scenario.world), driven.tracks)
    one, parts = Sensors(scenario, 10.0, rngs), Sensors(scenario, 10.0, pieces)
    whole, _ = one.read(driven, scene)
    read = [parts.read(driven, scene, until)[0] for until in (0.05, 2.0, 2.02, 7.7, np.inf)]
    for stream, field in (
        *(("lidar", "stamps"), ("encoders", "stamps"), ("encoders", "counts")),
        *(("imu", "stamps"), ("imu", "angular_velocity")),
    ):
        joined = np.concatenate([getattr(getattr(part, stream), field) for part in read])
        assert joined.tobytes() == getattr(getattr(whole, stream), field).tobytes(), field
    ranges = np.concatenate([part.lidar.ranges for part in read])
    known = np.isfinite(ranges) & np.isfinite(whole.lidar.ranges)
    off = np.abs(ranges[known] - whole.lidar.ranges[known])
    assert np.percentile(off, 95) < 0.1


def test_commands_that_are_no_numbers_and_steps_after_the_end_are_refused():
    simulator = Simulator(short(12.0))
    for asked, field in (((np.nan, 0.0), "speed"), (("a", 1), "speed"), ((0.1, None), "turn_rate")):
        with refusal(InputError, field=field):
            simulator.step(*asked)
    while not simulator.done:
        simulator._run.step()
    with refusal(ConfigError, field="duration"):
        simulator.step(0.0, 0.0)


def test_being_carried_along_a_route_is_refused():
    with refusal(ConfigError, "no route", field="faults.0.to"):
        Simulator(short(40.0).with_(faults=[{"kind": "carried", "start": 12.0}]))


def identical(a: Recording, b: Recording) -> bool:
    """In every array and figure, by its bytes."""
    first, second = dict(values_of(a)), dict(values_of(b))
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
    others = dict(values_of(other.recording))
    for name, ours in values_of(simulation.recording):
        assert ".figures." in name or ours.tobytes() != others[name].tobytes(), name


def test_the_seed_is_the_scenarios_where_none_is_given(scenario: Scenario, simulation: Simulation) -> None:
    assert identical(simulate(scenario.model_copy(update={"seed": 4})).recording, simulation.recording)
    assert simulation.scenario.seed == 4
    zero = simulate(scenario.model_copy(update={"seed": 4}), seed=0)
    assert zero.scenario.seed == 0
    assert not identical(zero.recording, simulation.recording)
    with refusal(ConfigError, field="seed"):
        simulate(scenario, seed=-1)


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
    truth = read_tum(tmp_path / "truth.tum")
    assert truth.stamps.tobytes() == simulation.truth.stamps.tobytes()
    np.testing.assert_allclose(truth.poses, simulation.truth.poses, atol=1e-12)
    assert load_scenario(tmp_path / "scenario.toml") == simulation.scenario
