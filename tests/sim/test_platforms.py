"""Every robot is what its file says: its figures are measured from a recording of it in a room.

The room is bare and the robot rests before and after a short drive, so that all of it can be measured. Tolerances are
three standard deviations of what was drawn, or as said.
"""

from functools import cache
from pathlib import Path

import numpy as np
import pytest
from box_ranges import box_ranges
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.inspection import Inspection, inspect_recording
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import bundled_platform, bundled_platforms, load_platform
from moteslam.robot.recording import Recording
from moteslam.robot.wheel_odometry import wheel_motion
from moteslam.sim.output import write_simulation
from moteslam.sim.scenario import bundled_scenarios, load_scenario, parse_scenario
from moteslam.sim.simulate import Simulation, simulate, true_drive
from moteslam.sim.world.world import World

ROOM = (9.0, 5.0)
REST = 3.0
TABLE = {
    "name": "room",
    "world": {"rooms": [{"corner": [0.0, 0.0], "size": list(ROOM)}]},
    "route": {"waypoints": [[1.2, 2.0], [3.6, 2.0], [4.2, 3.2]]},
    "drive": {"rest_start": REST, "rest_end": REST},
}

BASED = """
base = "turtlebot3"
top_speed = 0.5

[wheels]
metres_per_count = 1.0e-4

[lidar]
x = 0.02
yaw = 0.3
beams = 180
angle_min = 3.0
angle_increment = -0.034
time_increment = 0.0006
rate = 8.0
range_max = 6.0
no_return = [6.5, 7.0]

[noise.lidar]
range_noise = 0.004
range_noise_per_metre = 0.02
resolution = 0.002
dropout = 0.05
"""


@cache
def robots() -> dict[str, Platform]:
    return {name: bundled_platform(name) for name in bundled_platforms()}


class Run:
    """A simulation of a robot in the room, as it is read from the disk again."""

    def __init__(self, platform: Platform, folder: Path) -> None:
        self.simulation: Simulation = simulate(parse_scenario({**TABLE, "platform": platform}), 5)
        write_simulation(folder, self.simulation)
        self.platform = platform
        self.recording: Recording = open_recording(folder)
        self.found: Inspection = inspect_recording(self.recording)
        self.lidar = self.recording.lidar
        self.resting = self.lidar.ranges[self.lidar.stamps < self.simulation.truth.stamps[0] + REST - 0.3]

    def rate(self, stream: str) -> float:
        return next(one.mean_rate for one in self.found.streams if one.name == stream) or 0.0


@pytest.fixture(scope="module", params=[*robots(), "based"])
def run(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Run:
    folder = tmp_path_factory.mktemp(request.param)
    if request.param in robots():
        return Run(robots()[request.param], folder / "out")
    (folder / "robot.toml").write_text(BASED)
    return Run(load_platform(folder / "robot.toml"), folder / "out")


def walls_at(platform: Platform, pose: NDArray[np.float64]) -> NDArray[np.float64]:
    """The true range [beams] [m] of every beam of a robot that stands in the room."""
    x, y, heading = se2.compose(pose, np.array(platform.lidar.pose))
    scan = platform.lidar.scan
    angles = heading + scan.angle_min + scan.angle_increment * np.arange(scan.beams)
    return box_ranges(x, y, angles, (0.0, 0.0), ROOM)


def test_the_scan_is_that_of_the_data_sheet(run: Run) -> None:
    scan, found = run.platform.lidar.scan, run.found.lidar
    assert (found.beams, found.angle_min, found.angle_increment) == (scan.beams, scan.angle_min, scan.angle_increment)
    assert (found.range_min, found.range_max) == (scan.range_min, scan.range_max)
    assert found.turns == ("clockwise" if scan.angle_increment < 0 else "counterclockwise")
    assert scan.range_min <= found.nearest < found.farthest <= scan.range_max
    noise = run.platform.noise.lidar
    assert run.rate("lidar") == pytest.approx(scan.rate, rel=3 * noise.clock.rate_error + 0.005)
    assert found.resolution == pytest.approx(noise.resolution, rel=0.01)
    assert found.invalid == pytest.approx(noise.dropout, abs=3 * np.sqrt(noise.dropout / run.lidar.ranges.size))


def test_beams_look_where_the_data_sheet_says(run: Run) -> None:
    true = walls_at(run.platform, run.simulation.truth.poses[0])
    noise, limit = run.platform.noise.lidar, run.platform.lidar.scan.range_max
    spread = noise.range_noise + noise.range_noise_per_metre * true + noise.resolution
    within = true < limit - 4 * spread
    assert within.mean() > 0.3
    beyond = run.resting[:, true > limit + 4 * spread]
    assert np.isinf(beyond[~np.isnan(beyond)]).all()
    assert beyond.size or limit > 9  # the room's length
    seen = np.nanmean(run.resting[:, within], axis=0)
    # the mean of that many readings; half a step more where a small noise always rounds the same way
    tolerance = 4 * spread[within] / np.sqrt(len(run.resting)) + noise.resolution / 2
    assert (np.abs(seen - true[within]) < tolerance).mean() > 0.99


def test_range_noise_grows_as_configured(run: Run) -> None:
    noise = run.platform.noise.lidar
    true = walls_at(run.platform, run.simulation.truth.poses[0])
    steady = ~np.isinf(run.resting).any(axis=0) & (np.isfinite(run.resting).sum(axis=0) > 5)
    near = true < np.median(true[steady])
    growth = []
    for half in (near, ~near):
        ranges = true[half & steady]
        # rounding adds the variance of a uniform error; as many steps as there are beams, so its mean counts
        expected = (noise.range_noise + noise.range_noise_per_metre * ranges) ** 2 + noise.resolution**2 / 12
        found = np.nanvar(run.resting[:, half & steady].astype(np.float64), axis=0, ddof=1)
        assert np.sqrt(found.mean() / expected.mean()) == pytest.approx(1, abs=0.12)
        growth.append((found.mean(), expected.mean()))
    (near_found, near_expected), (far_found, far_expected) = growth
    assert far_found / near_found == pytest.approx(far_expected / near_expected, rel=0.25)


def test_wheels_count_the_distance(run: Run) -> None:
    platform, encoders, truth = run.platform, run.recording.encoders, run.simulation.truth
    noise = platform.noise.encoders
    driven = float(wheel_motion(encoders.counts, platform.wheels)[0].sum())
    seconds = float(truth.stamps[-1] - truth.stamps[0]) - 2 * REST
    slips = max(1.0, seconds / (2 * noise.slip_time))  # independent ones of a side, and two sides
    sigma = np.sqrt(noise.scale_error**2 + noise.radius_error**2 / 2 + noise.slip**2 / (2 * slips))
    assert driven == pytest.approx(truth.length, rel=3 * sigma + 0.002)
    clock = noise.clock
    assert run.rate("encoders") == pytest.approx(platform.encoders.rate, rel=3 * clock.rate_error + 0.005)
    if platform.wheels.wheel_base == 0:
        np.testing.assert_array_equal(encoders.counts[:, :2], encoders.counts[:, 2:])


def test_the_imu(run: Run) -> None:
    platform, gyro = run.platform, run.found.gyro_at_rest
    if platform.imu is None:
        assert run.recording.imu is None
        return
    noise = platform.noise.imu
    assert run.rate("imu") == pytest.approx(platform.imu.rate, rel=3 * noise.clock.rate_error + 0.005)
    # correlated over some 10 readings, 400 readings are good for a tenth
    assert gyro.deviation == pytest.approx(noise.gyro_noise, rel=0.3)
    assert abs(gyro.mean) < noise.gyro_bias * (1 + 3 * noise.gyro_bias_spread) + noise.gyro_noise / 4


def test_the_top_speed_is_driven_and_kept(run: Run) -> None:
    truth, top = run.simulation.truth, run.platform.top_speed or 9.0
    assert run.simulation.end == "arrived"
    speed = np.hypot(*(truth.poses[10:, :2] - truth.poses[:-10, :2]).T).max() / 0.1
    wanted = min(top, 0.95)
    assert 0.85 * wanted < speed < 1.02 * wanted


NARROW = ("corridor", "doors")
"""Where the width of a robot matters: driven by all that drive unlike the others. The other scenarios are driven by the
widest, but for `campus` and `mile`, which take long."""

UNLIKE = {(one.width, one.wheels.effective_track, one.top_speed): name for name, one in robots().items()}.values()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("robot", "name"),
    [
        (robot, name)
        for name in bundled_scenarios()
        if name not in ("campus", "mile")
        for robot in (UNLIKE if name in NARROW else ("ucsd",))
    ],
)
def test_every_robot_arrives_and_touches_no_wall(robot: str, name: str) -> None:
    scenario = load_scenario(name, platform=robot)
    run = true_drive(scenario)
    assert run.end == "arrived"
    assert World.of(scenario.world).is_free(run.poses[::20, :2], scenario.platform.width / 2).all()
