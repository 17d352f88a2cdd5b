"""The lidar: where beams end, noise, wide beams, errors of a recording, tilt, and surfaces that answer seldom."""

from typing import Any

import numpy as np
import pytest
from scipy.optimize import minimize
from sim_drives import moving, steady

from moteslam.robot import se2
from moteslam.robot.noise import DriveNoise, LidarNoise
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import LidarStream
from moteslam.sim.robot.drive import Drive
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.echoes import Rays, Scene
from moteslam.sim.sensors.lidar import Lidar, LidarErrors, beam_ranges, measured, tilt_of, tilted
from moteslam.sim.simulate import Simulation, simulate
from moteslam.sim.world.layout import Layout, Room, Wall
from moteslam.sim.world.pieces import Box, Material
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")

ROOM = World.of(Layout(rooms=(Room(corner=(0, 0), size=(12, 9)),), boxes=(Box(centre=(8, 6), size=(1, 1)),)))
MOUNT = UCSD.lidar
WITHOUT_DROPOUT = UCSD.noise.lidar.model_copy(update={"dropout": 0.0})


def endpoints(run: Drive, stream: LidarStream, *, swept: bool) -> np.ndarray:
    """The endpoints [n, beams, 2] in the world, each beam from its own pose, or all from the first beam's."""
    offsets = MOUNT.time_increment * np.arange(1081) * swept
    times = stream.stamps[:, None] + offsets
    robot = np.stack([np.interp(times, run.stamps, run.poses[:, axis]) for axis in range(3)], axis=-1)
    lidar = se2.compose(robot, MOUNT.pose)
    angles = lidar[..., 2] + stream.angles
    return lidar[..., :2] + stream.ranges[..., None] * np.stack((np.cos(angles), np.sin(angles)), axis=-1)


def test_perfect_beams_end_on_the_walls() -> None:
    run = moving((3.0, 3.0, 0.3), (0.8, 0.3, 0.9), 2.0)
    rng, effects = np.random.default_rng(0), np.random.default_rng(0)
    lidar = Lidar(MOUNT, LidarNoise(), (0.1, run.stamps[-1] - 0.1), rng, effects=effects)
    stream = lidar.read(run, Scene(ROOM), len(lidar.times))
    assert stream.ranges.shape[1] == 1081
    assert stream.ranges.dtype == np.float32
    assert stream.angles[[0, -1]] == pytest.approx(np.radians([-135, 135]))
    assert np.diff(stream.stamps) == pytest.approx(1 / 40)
    assert np.isfinite(stream.ranges).all()
    swept = ROOM.distance(endpoints(run, stream, swept=True))
    assert swept.max() < 1e-3  # float32 rays over 15 m
    at_once = ROOM.distance(endpoints(run, stream, swept=False))
    assert at_once.max() > 0.05  # turning at 0.9 rad/s for 19 ms, a wall 5 m away


@pytest.mark.parametrize(("metres", "data_sheet"), [(0.5, 0.01), (5.0, 0.01), (10.0, 0.01), (20.0, 0.02), (29.0, 0.03)])
def test_range_noise_is_the_data_sheets(metres: float, data_sheet: float) -> None:
    # UTM-30LX, repeated accuracy: sigma < 10 mm from 0.1 to 10 m, < 30 mm from 10 to 30 m
    ranges = measured(np.full(200_000, metres, np.float32), MOUNT.scan, UCSD.noise.lidar, np.random.default_rng(0))
    spread = np.nanstd(ranges)
    assert data_sheet / 1.5 <= spread <= data_sheet * 1.5
    assert np.nanmean(ranges) == pytest.approx(metres, abs=0.001)


def test_limits_of_the_ranges() -> None:
    exact = np.array([0.05, 0.2, 29.99, 30.5, np.inf], np.float32)
    ranges = measured(exact, MOUNT.scan, LidarNoise(), np.random.default_rng(0))
    np.testing.assert_array_equal(ranges, np.array([np.nan, 0.2, 29.99, np.inf, np.inf], np.float32))
    noisy = measured(np.full(10_000, 29.99, np.float32), MOUNT.scan, WITHOUT_DROPOUT, np.random.default_rng(0))
    assert np.isposinf(noisy).any()
    assert noisy[np.isfinite(noisy)].max() <= 30
    np.testing.assert_allclose(noisy * 1000, np.round(noisy * 1000), atol=2e-3)  # millimetres


def test_outliers_are_as_many_and_as_far_as_asked() -> None:
    noise = LidarNoise(range_noise=0.003, outliers=0.1, outlier_noise=0.1)
    off = np.abs(measured(np.full(100_000, 5.0, np.float32), MOUNT.scan, noise, np.random.default_rng(0)) - 5.0)
    assert (off > 0.02).mean() == pytest.approx(0.1 * 0.841, rel=0.05)  # of a normal, this share is beyond 0.2 sigma
    assert off[off > 0.02].max() > 0.25
    assert np.median(off) == pytest.approx(0.6745 * 0.003, rel=0.15)


N = 20_000
BOX = Scene(
    World.of(Layout(rooms=(Room(corner=(-10, -10), size=(20, 20)),), boxes=(Box(centre=(9.5, 3), size=(1, 6)),)))
)
"""A box whose front, at x = 9, ends at y = 0; behind it the wall at x = 10."""


def beams(noise: LidarNoise, angles: np.ndarray, scene: Scene = BOX) -> np.ndarray:
    n = len(angles)
    return beam_ranges(scene, Rays(np.zeros((n, 2)), angles, np.zeros(n)), MOUNT.scan, noise, np.random.default_rng(2))


def test_a_wide_beam_at_an_edge_measures_something_in_between() -> None:
    np.testing.assert_allclose(beams(LidarNoise(), np.array([0.002, -0.002])), [9.0, 10.0], atol=1e-4)
    edge = np.full(N, 0.001)
    ranges = beams(LidarNoise(divergence=0.013, mixed=0.5, pulse=2.0), edge)
    assert ((ranges > 9.05) & (ranges < 9.95)).mean() == pytest.approx(0.5 * 0.9, abs=0.03)
    apart = beams(LidarNoise(divergence=0.013, mixed=0.5, pulse=0.5), edge)
    assert not ((apart > 9.01) & (apart < 9.99)).any()  # a metre is too far for one echo
    assert (apart > 9.5).mean() == pytest.approx(0.25, abs=0.02)
    # the wall in the south, seen from square on to flat: its slope is no edge
    angles = -np.pi / 2 + np.linspace(-1.1, 0.7, 500)
    np.testing.assert_array_equal(beams(LidarNoise(divergence=0.013), angles), beams(LidarNoise(), angles))


def test_false_returns_are_short_and_as_many_as_asked_for() -> None:
    ranges = beams(LidarNoise(false_return=0.1, false_scale=1.0), np.full(N, -0.3))
    wall = 10.0 / np.cos(0.3)
    early = ranges < wall - 1e-3
    assert early.mean() == pytest.approx(0.1, abs=0.01)
    assert (ranges[early] - 0.1).mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(ranges[~early], wall, atol=1e-3)


def recorded(table: dict[str, Any], seed: int, drive: dict[str, float] | None = None, **lidar: Any) -> Simulation:
    """A short drive with the LMS200, whose only errors are these."""
    task = {key: value for key, value in table.items() if key != "route"}
    task["commands"] = {"start": [3.0, 3.0, 0.0], "steps": [{"duration": 3.0, "speed": 0.5, "turn_rate": 0.4}]}
    base = parse_scenario({**task, "platform": "lms200"}).platform
    perfect = base.model_copy(update={"noise": base.noise.model_validate({"lidar": lidar, "drive": drive or {}})})
    return simulate(parse_scenario({**task, "platform": perfect}), seed)


def test_biases_scales_and_clock_offsets_are_one_a_recording(table: dict[str, Any]) -> None:
    plain = [recorded(table, seed).recording.lidar for seed in (1, 2)]

    def off(measure: str, even: float, **errors: Any) -> np.ndarray:
        """What a recording of each seed differs by, the same over all of it."""
        changed = [recorded(table, seed, **errors).recording.lidar for seed in (1, 2)]
        found = [getattr(a, measure) - getattr(b, measure) for a, b in zip(changed, plain, strict=True)]
        assert max(np.ptp(one) for one in found) < even
        return np.array([one.mean() for one in found])

    late = off("stamps", 1e-6, clock={"offset_error": 0.1})
    for found, least in ((off("ranges", 1e-4, range_bias=0.1), 0.001), (late, 0.005)):
        assert np.abs(found).min() > least
        assert abs(found[0] - found[1]) > least
    factor = recorded(table, 1, range_scale_error=0.05).recording.lidar.ranges / plain[0].ranges
    assert np.ptp(factor) < 1e-4
    assert abs(factor.mean() - 1) > 0.001


def test_a_mount_error_moves_the_lidar_as_far_as_it_is_drawn(table: dict[str, Any]) -> None:
    noise = LidarNoise(mount_error=0.1, mount_yaw_error=0.1)
    drawn = [LidarErrors.drawn(noise, np.random.default_rng(i)) for i in range(400)]
    assert np.std([(one.x, one.y, one.yaw) for one in drawn], axis=0) == pytest.approx(0.1, rel=0.1)
    simulation = recorded(table, 1, mount_error=0.1, mount_yaw_error=0.1)
    lidar, stated = simulation.recording.lidar, simulation.recording.platform.lidar.pose

    # the endpoints lie on the walls from where the lidar truly is, and only from there
    def away(mount: np.ndarray) -> float:
        at = np.searchsorted(simulation.truth.stamps, lidar.stamps[0])
        pose = se2.compose(simulation.truth.poses[at], mount)
        angles = pose[2] + lidar.angles
        ends = pose[:2] + lidar.ranges[0][:, None] * np.stack((np.cos(angles), np.sin(angles)), axis=1)
        return float(simulation.world.distance(ends).mean())

    assert away(stated) > 0.01
    best = minimize(away, stated, method="Nelder-Mead", options={"maxiter": 2000})
    assert best.fun < 1e-3
    assert np.hypot(*(best.x - stated)[:2]) > 0.02


@pytest.mark.parametrize("errors", [{"mount_tilt_error": 0.1}, {"drive": {"sway": 0.1}}, {"drive": {"shake": 0.1}}])
def test_a_lidar_that_tilts_measures_further_or_loses_beams(table: dict[str, Any], errors: dict[str, Any]) -> None:
    aslant, plain = recorded(table, 1, **errors), recorded(table, 1)
    ranges, level = aslant.recording.lidar.ranges, plain.recording.lidar.ranges
    seen = np.isfinite(ranges)
    assert np.isinf(ranges).any()
    assert (ranges[seen] >= level[seen] - 1e-4).all()
    assert (ranges[seen] > level[seen] + 1e-3).any()
    assert aslant.truth.poses.tobytes() == plain.truth.poses.tobytes()


def test_a_beam_that_dips_is_longer_until_it_ends_on_the_floor() -> None:
    level = np.array([5.0, 50.0, 5.0, 5.0, np.inf, np.nan], np.float32)
    bearings = np.array([0.0, 0.0, np.pi, np.pi / 2, 0.0, 0.0])
    found = tilted(level, np.array((0.0, 0.02)), bearings, 0.4)  # 2 cm down a metre: the floor is 20 m away
    longer = 5.0 / np.cos(0.02)  # ahead and, where it looks up, backwards
    np.testing.assert_allclose(found, [longer, np.inf, longer, 5.0, np.inf, np.nan], atol=1e-6)
    rolled = tilted(np.full(2, 50.0, np.float32), np.array((0.02, 0.0)), np.array((-np.pi / 2, np.pi / 2)), 0.4)
    np.testing.assert_array_equal(np.isfinite(rolled), [False, True])  # to the right it looks down


def leaning(velocities: np.ndarray, heading: np.ndarray) -> np.ndarray:
    poses = np.concatenate((np.cumsum(velocities, axis=0) / 400, heading[:, None]), axis=1)
    drive = Drive(np.arange(2001) / 400, poses, np.column_stack((velocities, heading)), np.zeros((2001, 4)), "arrived")
    return tilt_of(drive, DriveNoise(sway=0.02), np.zeros((2001, 2)))


def test_a_body_dips_when_it_brakes_leans_out_of_bends_and_shakes_with_its_speed() -> None:
    stamps = np.arange(2001) / 400
    speed = np.where(stamps < 2.5, stamps, 5 - stamps)  # 1 m/s^2 up, then down
    dips = leaning(np.stack((speed, 0 * speed), axis=1), 0 * speed)
    np.testing.assert_allclose(dips[[900, 1900]], [[0.0, -0.02], [0.0, 0.02]], atol=2e-4)
    bend = leaning(np.stack((np.cos(stamps), np.sin(stamps)), axis=1), stamps)  # 1 m/s^2 to the left
    np.testing.assert_allclose(bend[1000], (0.02, 0.0), atol=1e-3)  # to the right
    noise = DriveNoise(shake=0.01)
    drives = steady(60.0, speed=0.5), steady(5.0)
    driving, standing = (
        tilt_of(drive, noise, np.random.default_rng(0).standard_normal((len(drive.stamps), 2))) for drive in drives
    )
    assert driving.std(axis=0) == pytest.approx(0.005, rel=0.15)
    assert np.corrcoef(driving[:-40, 0], driving[40:, 0])[0, 1] == pytest.approx(np.exp(-1), abs=0.15)
    assert not standing.any()


def pane(material: str, **tables: Material) -> Scene:
    """A wall of a material at x = 2 from y = -9 to 9, and a plain one at x = 5."""
    front = Wall(points=((2.0, -9.0), (2.0, 9.0)), material=material)
    behind = Wall(points=((5.0, -30.0), (5.0, 30.0)))
    return Scene(World.of(Layout(walls=(front, behind), materials=tables)))


def echoes(scene: Scene, angle: float, x: float = 0.0) -> np.ndarray:
    """What N beams from (x, 0) in one direction measure [m]."""
    origins = np.tile((x, 0.0), (N, 1))
    return scene.echoes(Rays(origins, np.full(N, angle), np.zeros(N)), np.random.default_rng(1), max_range=30.0)


@pytest.mark.parametrize(("angle", "share"), [(0.0, 0.2), (0.6, 0.92), (-1.0, 0.92)])
def test_glass_lets_a_share_of_the_beams_pass(angle: float, share: float) -> None:
    ranges = echoes(pane("glass"), angle)
    passed = np.isclose(ranges, 5.0 / np.cos(angle), atol=2e-3)
    assert passed.mean() == pytest.approx(share, abs=0.02)
    np.testing.assert_allclose(ranges[~passed], 2.0 / np.cos(angle), atol=1e-4)


def test_black_answers_only_from_near() -> None:
    scene = pane("black")
    near, far = echoes(scene, 0.0, x=-4.5), echoes(scene, 0.0, x=-5.5)
    assert np.isnan(near).mean() == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(near[np.isfinite(near)], 6.5, atol=1e-3)
    assert np.isposinf(far).all()  # 7.5 m away, and what is behind it is hidden
    assert np.isposinf(echoes(scene, 0.9, x=-2.2)).all()  # 6.8 m away but aslant: 7 m * sqrt(cos 0.9) = 5.5 m


def test_a_mirror_measures_the_path_to_what_it_shows() -> None:
    # a beam at 0.7 rad to the normal meets the mirror at x = 2 and goes back to the wall at x = -3
    front = Wall(points=((2.0, -9.0), (2.0, 9.0)), material="mirror")
    back = Wall(points=((-3.0, -30.0), (-3.0, 30.0)))
    always = Material(mirrors=1.0, lobe=0.1)
    scene = Scene(World.of(Layout(walls=(front, back), materials={"mirror": always})))
    np.testing.assert_allclose(echoes(scene, 0.7), (2.0 + 5.0) / np.cos(0.7), atol=1e-3)
    np.testing.assert_allclose(echoes(scene, 0.0), 2.0, atol=1e-5)  # it shows the sensor itself
    shiny = echoes(pane("shiny"), 0.7)
    seen = np.isclose(shiny, 2.0 / np.cos(0.7), atol=1e-4)
    assert seen.mean() == pytest.approx(0.3 * 0.9, abs=0.02)
    assert np.isnan(shiny).mean() == pytest.approx(0.3 * 0.1, abs=0.01)
