"""Images of bags."""

from pathlib import Path

import numpy as np
import pytest
from made_bags import START, imu, make_bag
from numpy.typing import NDArray

from moteslam import open_recording
from moteslam.robot.formats.bags.write import Event, camera_transforms, image_events, write_bag
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


def events(encoding: str = "", *, width: int = WIDTH, focal: float = 1.0, camera: bool = True) -> list[Event]:
    """Images as written, in other encodings, or of other cameras."""
    found = [event for stream in image_events(recording_of().rgbd, []) for event in stream]
    changed = []
    for event in found:
        values = event.values
        if event.kind == "sensor_msgs/CameraInfo":
            values = {**values, "width": width, "K": values["K"] * focal, "k": values["k"] * focal}
        if encoding and event.topic == "/camera/depth/image_raw/compressed":
            depth = depth_of(Drawn().disparity((event.time - START) // 100_000_000))
            content = depth.astype(">f4") if encoding == "32FC1" else np.nan_to_num(1000 * depth).round().astype("<u2")
            values = {
                "header": values["header"],
                "height": HEIGHT,
                "width": WIDTH,
                "encoding": encoding,
                "is_bigendian": int(encoding == "32FC1"),
                "step": WIDTH * content.itemsize,
                "data": np.frombuffer(content.tobytes(), np.uint8),
            }
            event = Event(event.time, "/camera/depth/image_raw", "sensor_msgs/Image", values)
        changed.append(Event(event.time, event.topic, event.kind, values))
    if camera and UCSD.camera is not None:
        changed.append(
            Event(START, "/tf_static", "tf2_msgs/TFMessage", {"transforms": camera_transforms(START, UCSD.camera)})
        )
    return [*changed, imu(0, (0.0, 0.0, 0.0), frame="base_link")]


@pytest.mark.parametrize("encoding", ["", "16UC1", "mono16", "32FC1"])
def test_depths_in_several_encodings_are_read(tmp_path: Path, encoding: str) -> None:
    recording = open_recording(make_bag(tmp_path, events(encoding)))
    assert recording.warnings == ()
    np.testing.assert_array_equal(recording.rgbd.images.disparity(2), Drawn().disparity(2))


def test_the_mount_of_the_camera_is_the_transforms(tmp_path: Path) -> None:
    camera = open_recording(make_bag(tmp_path, events())).platform.camera
    for key in ("x", "y", "z", "roll", "pitch", "yaw"):
        assert getattr(camera, key) == pytest.approx(getattr(UCSD.camera, key), abs=1e-12)


@pytest.mark.parametrize(
    ("material", "problem"),
    [
        (events(width=1280), "480 x 1280 pixels, expected 480 x 640"),
        (events(focal=1.1), "its corners lie 64 pixels from the Kinect's, expected at most 4"),
        (events(camera=False), "no transform to the frame of /camera/depth/image_raw/compressed"),
        ([event for event in events() if "depth" not in event.topic], r"compressed \(no depth beside it\)"),
        ([event for event in events() if event.kind != "sensor_msgs/CameraInfo"], "CameraInfo: none beside it"),
    ],
)
def test_images_of_other_cameras_are_left_out_with_the_reason(
    tmp_path: Path, material: list[Event], problem: str
) -> None:
    recording = open_recording(make_bag(tmp_path, material))
    assert recording.rgbd is None
    issue = next(issue for issue in recording.warnings if issue.code == "images-left")
    assert problem.replace("\\", "") in issue.message


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
