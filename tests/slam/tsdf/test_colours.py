"""Colours of the floor in the weights: which frame a scan gets, what it measures, and what becomes of lost ones."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from issues import messages
from parts.runs import with_images
from slam_rooms import ate, run, tiled_room

from moteslam.robot import se2
from moteslam.robot.recording import Recording, RgbdStream
from moteslam.sim.scenario import load_scenario, with_camera
from moteslam.sim.simulate import Simulation, simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.inputs.camera import FloorViews
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.online import run_slam
from moteslam.slam.tsdf import filter as tsdf_filter
from moteslam.slam.tsdf.config import ColourConfig, TsdfFilterConfig
from moteslam.slam.tsdf.floor import FloorLikelihood
from moteslam.slam.tsdf.proposal import Proposal

pytestmark = pytest.mark.usefixtures("taichi")

QUICK = ["particles=6", "texture.enabled=false"]
CONFIG = resolve_config("default", ["colours.enabled=true", *QUICK])
Room = tuple[Simulation, Recording]
OLDEST = CONFIG.colours.largest_age


def views_of(recording: Recording) -> FloorViews:
    return views_over(recording, synchronise(recording))


def views_over(recording: Recording, inputs: Inputs) -> FloorViews:
    return FloorViews(lambda: recording.rgbd, recording.platform.camera, inputs, largest_gap=CONFIG.texture.largest_gap)


@pytest.fixture(scope="module")
def room(taichi: None) -> Room:
    simulation = tiled_room()
    return simulation, with_images(simulation)


@pytest.fixture(scope="module")
def estimate(room: Room) -> Estimate:
    return run_slam(room[1], CONFIG, seed=3)


@pytest.fixture(scope="module")
def without(room: Room) -> Estimate:
    return run_slam(room[1], resolve_config("default", QUICK), seed=3)


def same(a: Estimate, b: Estimate) -> bool:
    return all(
        left.poses.tobytes() == right.poses.tobytes()
        for left, right in ((a.trajectory, b.trajectory), (a.trajectory_final, b.trajectory_final))
    )


def test_a_scan_gets_the_newest_frame_and_each_frame_is_used_once(room: Room) -> None:
    recording = room[1]
    views = views_of(recording)
    ages, last = [], -np.inf
    for index in range(40, len(recording.lidar), 5):
        view = views.at(index, OLDEST)
        if view is not None:
            scan = recording.lidar.stamps[index]
            assert view.frame.stamp <= scan
            assert last < view.frame.rgb_stamp <= scan
            last = view.frame.rgb_stamp
            ages.append(scan - last)
    assert len(ages) > 20
    assert np.median(ages) < 0.1
    assert max(ages) <= OLDEST
    assert views.asked > len(ages) == views.count.used


class Blank:
    """Images that show nothing."""

    def rgb(self, index: int) -> np.ndarray:
        return np.zeros((480, 640, 3), np.uint8)

    def disparity(self, index: int) -> np.ndarray:
        return np.zeros((480, 640), np.uint16)


def test_which_frame_a_scan_gets_does_not_depend_on_images_that_come_later(room: Room) -> None:
    recording, inputs = room[1], synchronise(room[1])
    lidar, rgbd = recording.lidar, recording.rgbd
    # colours at odd times: the nearest ones come before a disparity image or after it
    odd = np.sort(rgbd.rgb_stamps + np.random.default_rng(0).uniform(0.0, 0.04, len(rgbd.rgb_stamps)))
    stream = replace(rgbd, rgb_stamps=odd, images=Blank())

    def handed_out(stream: RgbdStream, scans: range) -> list[tuple[float, float] | None]:
        """The stamps of the frames that the scans get."""
        views = views_over(recording.replace(rgbd=stream), inputs)
        got = (views.at(scan, OLDEST) for scan in scans)
        return [None if view is None else (view.frame.stamp, view.frame.rgb_stamp) for view in got]

    complete = handed_out(stream, range(40, 120))
    assert sum(frame is not None for frame in complete) > 20
    for scans in range(1, len(complete) + 1):
        now = lidar.stamps[40 + scans - 1]
        rgb, disparity = (stamps[stamps <= now] for stamps in (stream.rgb_stamps, stream.disparity_stamps))
        arrived = replace(stream, rgb_stamps=rgb, disparity_stamps=disparity)
        assert handed_out(arrived, range(40, 40 + scans)) == complete[:scans]


def test_the_odometrys_error_is_spread_over_the_motion(room: Room) -> None:
    views = views_of(room[1])
    view = next(view for view in (views.at(k, OLDEST) for k in range(10, 40)) if view is not None)
    odometry, moved = np.array((0.1, 0.0, 0.02)), np.array((0.08, 0.01, 0.03))  # in five times the age of the frame
    since = se2.inverse(view.corrected(odometry, moved, 5 * view.age).place)
    off = se2.between(se2.inverse(view.place), since)
    np.testing.assert_allclose(off, se2.between(odometry, moved) / 5, atol=1e-12)
    for seconds in (0.0, view.age / 2):  # no more than all of it
        since = se2.inverse(view.corrected(odometry, moved, seconds).place)
        off = se2.between(se2.inverse(view.place), since)
        np.testing.assert_allclose(off, se2.between(odometry, moved), atol=1e-12)
    np.testing.assert_allclose(view.corrected(odometry, odometry, 1.0).place, view.place, atol=1e-12)


def test_the_floor_measures_each_particles_offset_wherever_its_path_lies(room: Room) -> None:
    simulation, recording = room
    stamps = recording.lidar.stamps
    apart = np.array([(0.0, 0.0, 0.0), (3.0, 1.0, 0.5), (-2.0, 0.4, -2.0), (40.0, 50.0, 3.0)])
    tracker, views = FloorLikelihood(TsdfFilterConfig(colours=ColourConfig(map_length=0.5))), views_of(recording)
    for index in range(40, 230, 8):
        seen = views.at(index, OLDEST)
        if seen is not None:
            then, now = simulation.truth.at(np.array([seen.frame.rgb_stamp, stamps[index]])).poses
            np.testing.assert_allclose(seen.place, se2.between(now, then), atol=0.01)
            view, poses = seen, se2.compose(apart, now)
            tracker.add(view, poses, 0, 0.12)
    off = np.array([(0.0, 0.0, 0.0), (0.03, -0.02, 0.0), (-0.02, 0.0, 0.0), (0.0, 0.025, 0.0)])
    offsets, information = tracker.fit(view, se2.compose(poses, off), 0)
    np.testing.assert_allclose(offsets, -off, atol=0.005)
    np.testing.assert_allclose(offsets[1:] - offsets[0], -off[1:], atol=1e-9)
    assert np.linalg.eigvalsh(information[:2, :2]).min() > 1 / 0.02**2
    assert not information[2].any()
    worse, _ = tracker.fit(view, se2.compose(poses, off), 1)  # searched around another one: the same is found
    np.testing.assert_allclose(worse, offsets, atol=0.003)
    assert tracker.fit(view, se2.compose(poses, (5.0, 5.0, 0.0)), 0) is None  # where no floor is known
    nothing = replace(view, frame=replace(view.frame, disparity=np.full_like(view.frame.disparity, 2047)))
    assert tracker.fit(nothing, poses, 0) is None
    parents = np.array([3, 3, 1])
    tracker.resample(parents)
    children, _ = tracker.fit(view, poses[parents], 0)
    np.testing.assert_allclose(children, 0.0, atol=0.01)
    blank = replace(view, frame=replace(view.frame, rgb=np.full_like(view.frame.rgb, 128)))
    plain = FloorLikelihood(TsdfFilterConfig())
    assert plain.fit(blank, poses, 0) is None
    plain.add(blank, poses, 0, 0.0)
    assert plain.fit(blank, poses, 0) is None  # of one colour


def test_colours_take_part_and_nothing_is_lost_by_them(room: Room, estimate: Estimate, without: Estimate) -> None:
    assert not TsdfFilterConfig().colours.enabled
    assert not same(estimate, without)
    errors = [ate(e.trajectory_final, room[0].truth) for e in (estimate, without)]
    assert errors[0] < max(1.2 * errors[1], 0.02)
    assert not [line for line in messages(estimate.warnings) if "colours" in line]


def test_the_same_seed_gives_the_same_bytes_and_frames_are_read_at_updates_alone(
    room: Room, estimate: Estimate, monkeypatch: pytest.MonkeyPatch
) -> None:
    """And where colours weigh the particles all of the odometry's error is drawn."""
    sample, shares = tsdf_filter.sample, set[float]()

    def sampled(proposal: Proposal, *arguments: Any, **options: Any) -> np.ndarray:
        shares.add(proposal.position_share)
        return sample(proposal, *arguments, **options)

    monkeypatch.setattr(tsdf_filter, "sample", sampled)
    asked: list[int] = []
    stream = room[1].rgbd
    draw = stream.images.rgb
    watched = stream.images._replace(rgb=lambda index: asked.append(index) or draw(index))
    again = run_slam(room[1].replace(rgbd=replace(stream, images=watched)), CONFIG, seed=3)
    assert same(again, estimate)
    assert 10 < len(asked) == len(set(asked)) <= estimate.diagnostics["updated"].sum()
    assert shares == {1.0, CONFIG.proposal.sampled_share}


def of_broken_files(recording: Recording, folder: Path) -> Recording:
    stream, broken = recording.rgbd, folder / "broken.png"
    broken.write_bytes(b"no image")
    colours = (broken, *[None] * (len(stream.rgb_stamps) - 1))
    disparities = tuple(broken if k % 3 else None for k in range(len(stream.disparity_stamps)))
    return recording.replace(rgbd=replace(stream, images=None, rgb_files=colours, disparity_files=disparities))


def of_late_frames(recording: Recording, _: Path) -> Recording:
    stream = recording.rgbd
    late = {name: getattr(stream, name) + 60.0 for name in ("rgb_stamps", "disparity_stamps")}
    return recording.replace(rgbd=replace(stream, **late))


LOSSES: dict[str, tuple[Callable[[Recording, Path], Recording], list[str]]] = {
    "camera": (lambda r, _: r.replace(platform=r.platform.model_copy(update={"camera": None})), ["camera"]),
    "images": (lambda r, _: r.replace(rgbd=replace(r.rgbd, images=None)), ["images"]),  # stamps alone
    "files": (of_broken_files, ["image of theirs is missing", "broken.png", "no new frame at"]),
    "late": (of_late_frames, ["no new frame at"]),
}
"""What is done, and what lines say of it."""


@pytest.mark.parametrize("loss", LOSSES)
def test_without_frames_lines_say_so_and_the_bytes_are_as_without(
    room: Room, without: Estimate, tmp_path: Path, loss: str
) -> None:
    lose, told = LOSSES[loss]
    done = run_slam(lose(room[1], tmp_path), CONFIG, seed=3)
    lines = [line for line in messages(done.warnings) if "colours" in line]
    assert len(lines) == len(told)
    assert all(part in line for line, part in zip(lines, told, strict=True))
    assert same(done, without)


@pytest.mark.slow
def test_along_a_bare_hall_colours_take_away_half_of_the_error(taichi: None) -> None:
    simulation = simulate(with_camera(load_scenario("two_halls")).model_copy(update={"duration": 50.0}), 1)
    recording = with_images(simulation)
    alone = ("backend.method=none", "texture.enabled=false")  # the back end knows nothing of colours
    with_them, without_them = (run(recording, *more, *alone, seed=1) for more in (["colours.enabled=true"], []))
    assert ate(with_them.trajectory_final, simulation.truth) < ate(without_them.trajectory_final, simulation.truth) / 2
