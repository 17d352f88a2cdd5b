"""Pictures of scenarios: what they show, and that no text lies on other text; films as files, and their moments."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest
from figures import legend_of
from matplotlib.figure import Figure
from PIL import Image

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.report.film import CODECS, MAX_FRAMES, Pace, check_film, write_film
from moteslam.eval.report.scenarios import draw_scenario
from moteslam.sim.scenario import load_scenario


def test_free_space_is_white_and_the_rest_grey(tmp_path: Path, drawn: list[Figure]) -> None:
    scenario = load_scenario("loop")
    draw_scenario(tmp_path / "x.png", scenario)
    (axes,) = drawn[0].axes
    (picture,) = axes.images
    left, right, bottom, top = picture.get_extent()
    rest = ~np.ma.getmaskarray(picture.get_array())

    def grey_at(x: float, y: float) -> bool:
        rows, columns = rest.shape
        return bool(rest[int((y - bottom) / (top - bottom) * rows), int((x - left) / (right - left) * columns)])

    assert not grey_at(*scenario.start[:2])
    assert not grey_at(11.0, 17.0)  # a room behind an open door, at the top
    assert grey_at(11.0, 7.0)  # inside the loop


def test_the_legend_names_what_is_there(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_scenario(tmp_path / "a.png", load_scenario("lab"))
    draw_scenario(tmp_path / "b.png", load_scenario("people"))
    draw_scenario(tmp_path / "c.png", load_scenario("doors"))
    lab, people, doors = map(legend_of, drawn)
    assert lab == [
        *("free space", "shelf (3)", "table (7)", "chair (8)", "box (6)", "wall", "black", "shiny"),
        *("start", "route, 80 m", "goal"),
    ]
    assert people[-2:] == ["person, there and back", "person, strolls about"]
    assert doors[-2:] == ["door, shut", "door, as it opens"]


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
    try:
        check_film("x.mp4")
    except OutputError:
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
