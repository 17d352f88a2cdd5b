"""Images of bags."""

from pathlib import Path

import numpy as np
import pytest
from made_bags import make_bag
from numpy.typing import NDArray

from moteslam import open_recording
from moteslam.robot.formats.bags.write import MANIFEST, Event, events_of, write_bag
from moteslam.robot.formats.written import odometry_of
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import OdometryStream, Recording, RgbdStream
from moteslam.robot.rgbd import HEIGHT, NO_DISPARITY, WIDTH, camera_frames, depth_of, disparity_of, read_frame

STAMPS = 1.6e9 + 0.1 * np.arange(4)


class Drawn:
    """Images of disparities from 600 on, which millimetres tell apart, and of colours by number."""

    def rgb(self, index: int) -> NDArray[np.uint8]:
        return np.full((HEIGHT, WIDTH, 3), (index, 100, 200), np.uint8)

    def disparity(self, index: int) -> NDArray[np.uint16]:
        image = np.tile(np.arange(WIDTH, dtype=np.uint16) % 400 + 650, (HEIGHT, 1))
        image[index] = NO_DISPARITY
        return image


def recording_of() -> Recording:
    odometry = OdometryStream(STAMPS, np.zeros((4, 3)))
    return Recording("x", UCSD, odometry=odometry, rgbd=RgbdStream(STAMPS + 0.01, STAMPS, images=Drawn()))


@pytest.mark.parametrize("kind", ["bag", "mcap"])
def test_images_read_back(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"x.{kind}"
    issues = write_bag(path, recording_of(), kind=kind)
    assert [issue.code for issue in issues] == ["depths-rounded"]
    stream = open_recording(path).rgbd
    np.testing.assert_array_equal(stream.rgb_stamps, STAMPS + 0.01)
    frames = list(camera_frames(stream))
    assert len(frames) == 4
    for index, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.rgb, Drawn().rgb(index))
        np.testing.assert_array_equal(frame.disparity, Drawn().disparity(index))


def test_disparities_and_depths() -> None:
    raw = np.arange(0, 1088, dtype=np.uint16)
    np.testing.assert_array_equal(disparity_of(depth_of(raw)), raw)
    assert depth_of(np.uint16([400]))[0] == pytest.approx(1.03 / (3.31 - 0.00304 * 400))
    assert np.isnan(depth_of(np.uint16([2047, 1100]))).all()
    np.testing.assert_array_equal(disparity_of(np.array([0.0, np.nan, np.inf, -1.0, 0.01])), [2047] * 5)


def events() -> list[Event]:
    """The recording as it is written."""
    recording = recording_of()
    return list(events_of(recording, odometry_of(recording), []))


def test_images_that_were_not_written_here_are_left_out_and_told(tmp_path: Path) -> None:
    recording = open_recording(make_bag(tmp_path, [event for event in events() if event.topic != MANIFEST[0]]))
    assert recording.rgbd is None
    assert [(issue.code, issue.count) for issue in recording.warnings] == [("images-left", 2)]


def test_a_damaged_image_leaves_its_frame_out(tmp_path: Path) -> None:
    material = events()
    for event in material:
        if event.topic == "/camera/rgb/image_raw/compressed":
            event.values["data"] = event.values["data"][:-100]
    stream = open_recording(make_bag(tmp_path, material)).rgbd
    problem = read_frame(stream, 0, 0)
    assert isinstance(problem, str)
    assert "made.bag: /camera/rgb/image_raw/compressed: image 0: cut short or damaged" in problem


def test_an_image_that_declares_a_huge_size_is_not_decoded(tmp_path: Path) -> None:
    material = events()
    for event in material:
        if event.topic == "/camera/rgb/image_raw/compressed":
            content = event.values["data"].copy()
            content[16:24] = np.frombuffer((60000).to_bytes(4) * 2, np.uint8)
            event.values["data"] = content
    stream = open_recording(make_bag(tmp_path, material)).rgbd
    assert "60000 x 60000 pixels" in str(read_frame(stream, 0, 0))


def test_stamps_without_images_are_not_written(tmp_path: Path) -> None:
    recording = recording_of().replace(rgbd=RgbdStream(STAMPS, STAMPS))
    issues = write_bag(tmp_path / "x.bag", recording, kind="bag")
    assert [(issue.code, issue.count) for issue in issues] == [("not-written", 8)]
