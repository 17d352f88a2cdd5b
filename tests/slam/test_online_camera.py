"""A recording with a camera, message by message: the bytes of `run_slam`, and images that do not heap up."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from parts.runs import fed, with_images
from refusals import refusal
from slam_messages import platform_of
from slam_rooms import tiled_room

from moteslam.errors import ConfigError, InputError
from moteslam.robot.recording import Recording
from moteslam.robot.rgbd import depth_of
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.online import OnlineSlam, run_slam

pytestmark = pytest.mark.usefixtures("taichi")

COARSE = ["texture.cell_size=0.1", "texture.interval=0.3"]
CONFIGS = {
    "paper": resolve_config("paper", ["particles=10", *COARSE]),
    "colours": resolve_config("default", ["particles=5", "colours.enabled=true", *COARSE]),
}
BLANK = np.zeros((480, 640, 3), np.uint8)


@cache
def room() -> Recording:
    return with_images(tiled_room(gap=0.05, gap_frames=4))


@cache
def whole(name: str) -> Estimate:
    return run_slam(room(), CONFIGS[name], seed=3)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "late"),
    [("paper", 0.2), *(pytest.param(*each, marks=pytest.mark.slow) for each in (("paper", 0.0), ("colours", 0.2)))],
)
def test_a_recording_with_a_camera_gives_the_same_bytes(name: str, late: float):
    slam = OnlineSlam(platform_of(room()), CONFIGS[name], seed=3)
    list(fed(slam, room(), images=late))
    here, there = slam.estimate(), whole(name)
    for one in ("trajectory", "trajectory_final"):
        assert getattr(here, one).poses.tobytes() == getattr(there, one).poses.tobytes(), one
    assert here.map.values.tobytes() == there.map.values.tobytes()
    assert here.texture.values.tobytes() == there.texture.values.tobytes()
    assert here.texture.frames == there.texture.frames > 15
    told = [one.code for one in here.warnings if one.code != "not-calibrated"]  # run_slam holds no scans against others
    assert told == [one.code for one in there.warnings]
    if name == "colours":
        assert slam._views.count.used > 10
    assert all(len(images) < 90 for images in slam._camera._latest.values())


def test_depths_in_metres_are_taken_as_disparities():
    images = room().rgbd.images
    slams = [OnlineSlam(platform_of(room()), CONFIGS["paper"]) for _ in range(2)]
    for slam, change in zip(slams, (lambda image: image, depth_of), strict=True):
        slam.add_image(0.0, images.rgb(9))
        slam.add_image(0.0, change(images.disparity(9)))
        slam.finish()
    one, other = (slam._camera.used().images.disparity(0) for slam in slams)
    np.testing.assert_array_equal(one, other)


@pytest.mark.slow
def test_a_camera_that_falls_silent_does_not_stop_the_robot():
    images = room().rgbd
    recording = room().replace(rgbd=replace(images, rgb_stamps=images.rgb_stamps[:60]))
    slam = OnlineSlam(platform_of(recording), CONFIGS["colours"], patience=0.3)
    waiting = [slam.waiting for _ in fed(slam, recording)]
    assert 0.3 * 40 - 3 < max(waiting) < 0.3 * 40 + 3
    assert len(slam) == len(recording.lidar)


def test_images_that_cannot_be_used_are_refused():
    platform = platform_of(room())
    with refusal(InputError, "480, 640, 3", field="image"):
        OnlineSlam(platform).add_image(0.0, BLANK[:240])
    with refusal(ConfigError, field="platform.camera"):
        OnlineSlam(platform.model_copy(update={"camera": None})).add_image(0.0, BLANK)
