"""The coloured map of the floor against the true floor: colours, place, and what becomes of bad input."""

import shutil
from pathlib import Path

import cv2
import numpy as np
import pytest
from issues import messages
from numpy.typing import ArrayLike
from refusals import refusal
from slam_rooms import tiled_room
from twins.camera import add_frame

from moteslam.errors import InputError
from moteslam.robot import rgbd
from moteslam.robot.formats import open_recording
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.output import write_simulation
from moteslam.sim.simulate import Simulation
from moteslam.sim.world.floor import rasterise
from moteslam.slam.config import resolve_config
from moteslam.slam.online import run_slam
from moteslam.slam.texture.floor_map import TextureConfig, TextureMap, TextureMapper, can_map, map_texture


def score_texture(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike) -> tuple[float, float]:
    """Compare two pictures of the floor [H, W, 3] of levels 0 to 255, over the cells [H, W] that count.

    Returns:
        the mean error of a level over that of the best single colour, each channel's median of the true floor there;
        and the standard deviation of the true grey values.
    """
    seen, true = (np.asarray(picture, np.float64)[np.asarray(where, bool)] for picture in (estimate, truth))
    single = np.abs(true - np.median(true, axis=0)).mean()
    return float(np.abs(seen - true).mean() / single), float((true @ (0.299, 0.587, 0.114)).std())


def registration(estimate: ArrayLike, truth: ArrayLike, where: ArrayLike, *, reach: int = 4) -> tuple[int, int]:
    """By how many cells (columns, rows), up to ``reach``, the truth must be moved to fit the estimate best.

    The best fit has the smallest sum of squared differences, over the cells that count and are not as near to an edge.
    """
    estimate, truth, where = np.asarray(estimate, np.float32), np.asarray(truth, np.float32), np.asarray(where, bool)
    inner = (slice(reach, max(len(where) - reach, reach)), slice(reach, max(where.shape[1] - reach, reach)))
    if not where[inner].any():
        return 0, 0
    differences = cv2.matchTemplate(truth, estimate[inner], cv2.TM_SQDIFF, mask=where[inner].astype(np.float32))
    row, column = np.unravel_index(np.argmin(differences), differences.shape)
    return reach - int(column), reach - int(row)


Driven = tuple[Simulation, Path]


@pytest.fixture(scope="module")
def driven(taichi: None, tmp_path_factory: pytest.TempPathFactory) -> Driven:
    """Eight seconds in a room, both cameras at 6 Hz, on disk."""
    folder = tmp_path_factory.mktemp("tiles")
    simulation = tiled_room(rate=6.0, gap=0.0)
    write_simulation(folder, simulation)
    return simulation, folder


@pytest.fixture(scope="module")
def recording(driven: Driven) -> Recording:
    return open_recording(driven[1])


@pytest.fixture(scope="module")
def texture(driven: Driven, recording: Recording) -> TextureMap:
    """Coloured along the true trajectory; the colour camera is up to a twelfth of a second off at 6 Hz."""
    return map_texture(recording, driven[0].truth, TextureConfig(largest_gap=0.09))


def test_colours_are_right_and_in_place(driven: Driven, texture: TextureMap) -> None:
    left, right, bottom, top = texture.extent
    floor = driven[0].scenario.floor
    truth = rasterise(floor, (left, bottom, right, top), texture.cell_size, samples=4).values
    assert truth.shape == texture.values.shape
    share, grey_spread = score_texture(texture.values, truth, texture.known)
    assert grey_spread >= 40
    assert texture.known.sum() > 5000
    assert share <= 1 / 3
    assert registration(texture.values, truth, texture.known) == (0, 0)
    assert texture.warnings == ()


def test_nearly_all_that_the_camera_saw_is_coloured(driven: Driven, recording: Recording, texture: TextureMap) -> None:
    """By NumPy, in every frame from where the robot truly was."""
    coloured, config = np.pad(texture.known, 20), TextureConfig()
    place = {"corner": np.array(texture.origin[:2]) - 20 * texture.cell_size, "cell_size": texture.cell_size}
    sums = np.zeros((*coloured.shape, 4), np.int64)
    for frame in rgbd.camera_frames(recording.rgbd, largest_gap=0.09):
        (pose,) = driven[0].truth.at(np.array([frame.stamp])).poses
        limits = {"height_limit": config.height_limit, "max_depth": config.max_depth}
        add_frame(sums, frame.disparity, frame.rgb, pose, **place, **limits)
    seen = sums[..., 3] > 0
    assert seen.sum() > 5000
    assert (coloured & seen).sum() / seen.sum() >= 0.95


def test_frames_are_chosen_by_interval_and_gap(driven: Driven, recording: Recording) -> None:
    truth = driven[0].truth
    sizes: list[int] = []

    def watch(stamp: float, mapper: TextureMapper) -> None:
        sizes.append(mapper._sums.nbytes)

    every = map_texture(recording, truth, TextureConfig(interval=0.0, largest_gap=0.09), watch=watch).frames
    assert len(sizes) == every + 1
    assert len(set(sizes)) == 1  # memory does not grow with the frames
    some = map_texture(recording, truth, TextureConfig(interval=0.5, largest_gap=0.09)).frames
    assert every > 35
    assert some == pytest.approx(every / 3, abs=2)
    assert not map_texture(recording, truth, TextureConfig(largest_gap=0.0)).frames


def test_frames_beyond_the_trajectory_are_counted(driven: Driven, recording: Recording) -> None:
    truth = driven[0].truth
    middle = Trajectory(truth.stamps[200:500], truth.poses[200:500])
    texture = map_texture(recording, middle, TextureConfig(largest_gap=0.09))
    assert 15 < texture.frames < 22
    assert str(texture.warnings[-1]).endswith("frames left out, before the first pose or after the last")


def test_lost_images_are_told_and_the_rest_is_used(driven: Driven, texture: TextureMap, tmp_path: Path) -> None:
    folder = Path(shutil.copytree(driven[1], tmp_path / "copy"))
    (folder / "dataRGBD" / "RGB20" / "rgb20_4.png").unlink()
    (folder / "dataRGBD" / "Disparity20" / "disparity20_9.png").write_bytes(b"no")
    recording = open_recording(folder)
    partial = map_texture(recording, driven[0].truth, TextureConfig(largest_gap=0.09))
    assert partial.frames == texture.frames - 2
    assert [line.partition(" frame")[0] for line in messages(partial.warnings)] == ["camera: 1", "camera: 1"]
    assert "disparity20_9.png" in partial.warnings[1].message


def test_what_cannot_be_mapped_is_refused(driven: Driven, recording: Recording) -> None:
    truth = driven[0].truth
    stamps_only = driven[0].recording
    blind = recording.replace(platform=recording.platform.model_copy(update={"camera": None}))
    nowhere = Trajectory(np.empty(0), np.empty((0, 3)))
    far = Trajectory(truth.stamps[:2], np.array([(0.0, 0, 0), (1e5, 1e5, 0)]))
    assert can_map(recording)
    for what, along, field in (
        (stamps_only, truth, "rgbd"),
        (blind, truth, "platform.camera"),
        (recording, nowhere, "trajectory"),
        (recording, far, "texture.cell_size"),
    ):
        with refusal(InputError, field=field):
            map_texture(what, along)
    assert not can_map(stamps_only)
    assert not can_map(blind)


def test_run_slam_colours_the_floor_along_what_it_found(recording: Recording) -> None:
    settings = ["particles=4", "texture.cell_size=0.2", "texture.interval=1.0", "texture.largest_gap=0.09"]
    config = resolve_config("paper", settings)
    estimate = run_slam(recording, config)
    expected = map_texture(recording, estimate.trajectory_final, config.texture)
    assert expected.known.sum() > 100
    np.testing.assert_array_equal(estimate.texture.values, expected.values)
    assert estimate.texture.origin == expected.origin


def test_run_slam_colours_nothing_where_it_is_not_asked_for_or_cannot(
    recording: Recording, monkeypatch: pytest.MonkeyPatch
) -> None:
    settings = ["particles=4", "texture.cell_size=0.2", "texture.interval=1.0"]
    assert run_slam(recording, resolve_config("paper", [*settings, "texture.enabled=false"])).texture is None
    assert run_slam(recording.replace(rgbd=None), resolve_config("paper", settings)).texture is None
    monkeypatch.setattr("moteslam.slam.texture.floor_map.MAX_CELLS", 10)
    estimate = run_slam(recording, resolve_config("paper", settings))
    assert estimate.texture is None
    assert any("the floor is not coloured: texture.cell_size" in line for line in messages(estimate.warnings))
