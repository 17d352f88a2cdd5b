"""Camera images of the UCSD layout: read a frame at a time, and what becomes of the missing and the broken."""

import shutil
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest
from issues import messages

from moteslam.errors import OutputError
from moteslam.robot import rgbd
from moteslam.robot.formats.ucsd import read_ucsd, write_ucsd
from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import Recording, RgbdStream
from moteslam.robot.rgbd import FrameCount, camera_frames, has_images, pairs
from moteslam.sim import output as image_files

N = 8
RGB_STAMPS = 1.3e9 + np.arange(N) / 30
DISPARITY_STAMPS = RGB_STAMPS + 0.01


def rgb_image(index: int) -> np.ndarray:
    image = np.full((480, 640, 3), (10 * index % 256, 100, 200), np.uint8)
    image[:20, :30] = (255, 0, index % 256)  # upper left
    return image


def disparity_image(index: int) -> np.ndarray:
    return np.full((480, 640), 500 + index, np.uint16)


def drawn(count: int) -> Any:
    """So many images of each kind, as a simulation draws them."""
    shots = SimpleNamespace(stamps=range(count))
    return SimpleNamespace(
        rgb=shots,
        disparity=shots,
        draw_rgb=lambda chosen: np.stack([rgb_image(int(k)) for k in chosen]),
        draw_disparity=lambda chosen: np.stack([disparity_image(int(k)) for k in chosen]),
    )


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("recording")
    recording = Recording("x", UCSD, rgbd=RgbdStream(RGB_STAMPS, DISPARITY_STAMPS))
    write_ucsd(folder, recording, sequence=20)
    image_files.write_frames(folder, drawn(N), "20")
    return folder


@pytest.fixture
def folder(original: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(original, tmp_path / "recording"))


def frames(folder: Path, **settings: Any) -> tuple[list[Any], FrameCount, tuple[str, ...]]:
    recording, count = read_ucsd(folder), FrameCount()
    return list(camera_frames(recording.rgbd, count=count, **settings)), count, messages(recording.warnings)


def test_what_is_written_is_read_back(folder: Path) -> None:
    found, count, warnings = frames(folder)
    assert warnings == messages(count.issues()) == ()
    assert count.used == len(found) == N
    for index, frame in enumerate(found):
        assert frame.stamp == DISPARITY_STAMPS[index]
        assert frame.rgb_stamp == RGB_STAMPS[index]
        assert (frame.rgb == rgb_image(index)).all()
        assert (frame.disparity == disparity_image(index)).all()
        assert frame.disparity.dtype == np.uint16


def test_the_files_are_what_other_programs_expect(folder: Path) -> None:
    seen = cv2.imread(str(folder / "dataRGBD" / "RGB20" / "rgb20_3.png"), cv2.IMREAD_UNCHANGED)
    assert seen[0, 0].tolist() == [2, 0, 255]  # blue first, as OpenCV has it: the third image, counted from 1
    depth = cv2.imread(str(folder / "dataRGBD" / "Disparity20" / "disparity20_3.png"), cv2.IMREAD_UNCHANGED)
    assert depth.dtype == np.uint16
    assert (depth == 502).all()


def test_missing_images_are_counted(folder: Path) -> None:
    (folder / "dataRGBD" / "RGB20" / "rgb20_2.png").unlink()
    (folder / "dataRGBD" / "Disparity20" / "disparity20_5.png").unlink()
    found, count, warnings = frames(folder)
    assert [frame.rgb_stamp for frame in found] == [RGB_STAMPS[i] for i in (0, 2, 3, 5, 6, 7)]
    assert warnings == (
        "RGB20: 1 of 8 images missing, the first rgb20_2.png",
        "Disparity20: 1 of 8 images missing, the first disparity20_5.png",
    )
    assert messages(count.issues()) == ("camera: 2 frames left out, an image of theirs is missing",)


def cut(path: Path) -> None:
    data = path.read_bytes()
    path.write_bytes(data[: len(data) // 2])


def flip(path: Path) -> None:
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 255
    path.write_bytes(data)


@pytest.mark.parametrize(
    ("harm", "words"),
    [
        (lambda path: path.write_bytes(b""), "no PNG"),
        (cut, "cut short or damaged"),
        (flip, "cut short or damaged"),
        (lambda path: cv2.imwrite(str(path), np.zeros((480, 640), np.uint8)), "480 x 640 of 8 bits, expected"),
        (
            lambda path: cv2.imwrite(str(path), np.zeros((240, 320, 3), np.uint8)),
            "240 x 320 pixels, expected 480 x 640",
        ),
    ],
)
@pytest.mark.parametrize("kind", ["RGB", "Disparity"])
def test_unreadable_images_are_counted_and_the_first_is_named(folder: Path, harm: Any, words: str, kind: str) -> None:
    name = f"{kind.lower()}20_4.png"
    harm(folder / "dataRGBD" / f"{kind}20" / name)
    found, count, _ = frames(folder)
    assert len(found) == count.used == N - 1
    assert count.unreadable == 1
    (line,) = messages(count.issues())
    assert line.startswith("camera: 1 frame left out, unreadable; the first: ")
    assert name in line
    assert words in line
    assert "\n" not in line


def test_without_images_there_are_only_stamps(folder: Path) -> None:
    shutil.rmtree(folder / "dataRGBD")
    recording = read_ucsd(folder)
    assert not has_images(recording.rgbd)
    assert not has_images(None)
    found, count, warnings = frames(folder)
    assert (found, warnings) == ([], ())
    assert messages(count.issues())[-1] == "camera: no two images of one moment that can be read"


def test_the_nearest_colour_image_is_paired_if_it_is_near_enough() -> None:
    stream = RgbdStream(np.array([0.0, 1.0, 2.0, 3.0]), np.array([0.04, 0.96, 1.5, 2.03, 9.0]))
    disparity, rgb = pairs(stream, largest_gap=0.05)
    assert disparity.tolist() == [0, 1, 3]
    assert rgb.tolist() == [0, 1, 2]
    assert pairs(stream, interval=1.2, largest_gap=0.6)[0].tolist() == [0, 2]
    assert not len(pairs(RgbdStream(np.empty(0), np.array([1.0])))[0])


def test_reading_holds_few_frames_at_a_time(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    read = []
    real = rgbd.decode_rgb
    monkeypatch.setattr(rgbd, "decode_rgb", lambda content: read.append(1) or real(content))
    monkeypatch.setattr("moteslam.robot.rgbd.processor_count", lambda: 1)
    recording = read_ucsd(folder)
    stream = camera_frames(recording.rgbd)
    next(stream)
    stream.close()
    assert len(read) <= 5


def test_too_little_space_is_told_before_anything_is_written(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    frames = drawn(1000)
    wanted = image_files.estimate_bytes(frames.draw_rgb, 1000)
    assert 1000 * 2048 < wanted < 1000 * 200_000
    monkeypatch.setattr(shutil, "disk_usage", lambda _: shutil._ntuple_diskusage(10, 9, wanted - 1))
    with pytest.raises(OutputError, match=r"[1-9][0-9.]* [MG]B free, expected [1-9][0-9.]* [MG]B for the images"):
        image_files.write_frames(tmp_path, frames, "20")
    assert not list(tmp_path.iterdir())


def test_the_alignment_is_a_camera_26_mm_to_the_right() -> None:
    point = np.array((0.3, -0.2, 1.7))
    i, j = rgbd.FOCAL * point[:2] / point[2] + rgbd.CENTRE
    dd = 1.03 / point[2]
    published = ((526.37 * i - 4.5 * 1750.46 * dd + 19276) / 585.051, (526.37 * j + 16662) / 585.051)
    seen = rgbd.RGB_FOCAL * (point[:2] - (rgbd.RGB_OFFSET, 0)) / point[2] + rgbd.RGB_CENTRE
    assert seen == pytest.approx(published, abs=1e-9)
    assert pytest.approx(0.0263, abs=1e-4) == rgbd.RGB_OFFSET
