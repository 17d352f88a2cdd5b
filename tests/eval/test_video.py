"""Films as files: their frames, how long each is shown, and which moments of a run they show."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.report.film import CODECS, MAX_FRAMES, Pace, video_codec, write_film

SHADES = (20, 120, 240)
FRAMES = [np.full((61, 81, 3), (shade, shade, 40), np.uint8) for shade in SHADES]


@pytest.mark.parametrize("kind", [".gif", ".webp"])
def test_pictures_that_move_hold_their_frames(kind: str, tmp_path: Path) -> None:
    write_film(tmp_path / f"x{kind}", iter(FRAMES), fps=15.0)
    with Image.open(tmp_path / f"x{kind}") as film:
        assert film.n_frames == len(FRAMES)
        assert film.size == (81, 61)
        assert film.info["loop"] == 0
        for i, shade in enumerate(SHADES):
            film.seek(i)
            np.testing.assert_allclose(np.array(film.convert("RGB")).mean(axis=(0, 1)), (shade, shade, 40), atol=20)


def test_an_mp4_is_one_that_browsers_play(tmp_path: Path, capfd: pytest.CaptureFixture[str]) -> None:
    if video_codec() is None:
        pytest.skip("no encoder in this build of OpenCV")
    write_film(tmp_path / "x.mp4", FRAMES, fps=12.5)
    film = cv2.VideoCapture(str(tmp_path / "x.mp4"))
    assert film.get(cv2.CAP_PROP_FPS) == 12.5
    found = []
    while (read := film.read())[0]:
        found.append(read[1].mean(axis=(0, 1)))
        assert read[1].shape == (60, 80, 3)  # even
    np.testing.assert_allclose(found, [(40, shade, shade) for shade in SHADES], atol=20)
    content = (tmp_path / "x.mp4").read_bytes()
    assert content[4:8] == b"ftyp"
    assert any(codec.encode() in content for codec in CODECS)
    assert b"mp4v" not in content
    assert capfd.readouterr() == ("", "")


def test_frames_of_a_gif_last_as_long_as_asked_in_all(tmp_path: Path) -> None:
    frames = [np.full((8, 8, 3), shade, np.uint8) for shade in range(0, 240, 8)]
    write_film(tmp_path / "x.gif", frames, fps=15.0)
    lasts = []
    with Image.open(tmp_path / "x.gif") as film:
        for i in range(film.n_frames):
            film.seek(i)
            lasts.append(film.info["duration"])
    assert set(lasts) == {60, 70}
    assert sum(lasts) == 2000


def test_a_film_of_another_kind_is_refused(tmp_path: Path) -> None:
    for name in ("x.avi", "x", "x.png"):
        with pytest.raises(OutputError, match=r"x.*: expected a name"):
            write_film(tmp_path / name, FRAMES)


def test_moments_are_even_and_the_last_is_the_end() -> None:
    stamps = 100.0 + np.arange(101) / 10
    moments = Pace(fps=5.0, speed=2.0).moments(stamps)
    np.testing.assert_array_equal(np.diff(moments[:-1]), np.full(24, 4))
    assert (moments[0], moments[-1]) == (0, 100)
    slow = Pace(fps=50.0, speed=1.0).moments(stamps)
    assert set(np.bincount(slow)[:-1]) <= {4, 5, 6}  # stamps are no exact tenths
    np.testing.assert_array_equal(Pace(15.0, 1.0).moments(stamps[:1]), [0])


def test_a_speed_is_chosen_for_a_short_film() -> None:
    assert [Pace.of(duration).speed for duration in (3.0, 15.0, 16.0, 75.0, 100.0, 600.0)] == [1, 1, 2, 5, 10, 50]
    assert str(Pace.of(75.0)) == "5 × real time, 15 frames/s"
    with pytest.raises(ConfigError, match=f"at most {MAX_FRAMES} frames") as caught:
        Pace.of(600.0, speed=1.0)
    assert caught.value.field == "speed"
