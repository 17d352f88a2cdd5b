"""Floors: the same colours at any resolution, as varied as they are meant to be, pictures the right way up."""

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from moteslam.errors import ConfigError
from moteslam.sim.scenario import parse_scenario
from moteslam.sim.world.floor import FloorSettings, rasterise

GREY = np.array((0.299, 0.587, 0.114))
MATERIALS = ("tiles", "carpet", "wood", "plain")


@pytest.mark.parametrize("material", MATERIALS)
def test_a_colour_depends_on_the_place_alone(material: str) -> None:
    floor = FloorSettings(material=material, stains=0.2)
    points = np.random.default_rng(0).uniform(-30, 30, (500, 2))
    together = floor.colours_at(points)
    assert (together == np.stack([floor.colours_at(point) for point in points])).all()
    crowded = np.concatenate((points, np.random.default_rng(1).uniform(-1, 1, (100_000, 2))))
    assert (floor.colours_at(crowded)[:500] == together).all()


@pytest.mark.parametrize("material", MATERIALS)
def test_a_raster_holds_the_colours_at_its_cells(material: str) -> None:
    floor = FloorSettings(material=material)
    image = rasterise(floor, (-1.03, 2.0, 0.97, 3.5), 0.05)
    assert image.values.shape == (30, 41, 3)
    assert image.origin == pytest.approx((-1.05, 2.0, 0.0))
    for row, column in ((0, 0), (29, 3), (7, 40)):
        point = image.centres([(row, column)])[0]
        assert (image.values[row, column] == floor.colours_at(point)).all()
    bit = rasterise(floor, (-0.5, 2.5, 0.0, 3.0), 0.05)
    assert (bit.values == image.values[10:20, 11:21]).all()


def test_seeds_and_materials_differ_and_colours_vary() -> None:
    seen = [rasterise(FloorSettings(seed=seed), (0, 0, 20, 20), 0.05).values for seed in (0, 1)]
    assert (seen[0] != seen[1]).any(axis=-1).mean() > 0.7
    for material, least in (("tiles", 40), ("carpet", 40), ("wood", 40), ("plain", 1)):
        colours = rasterise(FloorSettings(material=material), (0, 0, 20, 20), 0.05).values
        assert (colours @ GREY).std() > least
        assert (colours @ GREY).mean() == pytest.approx(115, abs=25)


def test_a_share_of_the_floor_is_stained() -> None:
    clean, stained = (rasterise(FloorSettings(material="plain", stains=s), (0, 0, 30, 30), 0.05) for s in (0, 0.3))
    darker = (stained.values @ GREY < 0.9 * (clean.values @ GREY)).mean()
    assert darker == pytest.approx(0.3, abs=0.06)


def test_tiles_are_square_and_lie_on_multiples_of_their_size() -> None:
    floor = FloorSettings(size=0.4, colours=((255, 0, 0), (0, 0, 255)))
    a, b = floor.colours_at([(0.02, 0.02), (0.38, 0.38)]).astype(int)
    assert np.abs(a - b).max() < 30  # one tile, but for its shading
    assert (floor.colours_at([(0.4, 0.2), (0.2, 0.798)]) == 96).all()  # joints


def picture(path: Path) -> Path:
    """4 x 2 pixels: red in the upper left corner, green in the upper right one, blue in the lower left one."""
    image = np.full((2, 4, 3), 200, np.uint8)
    image[0, 0], image[0, 3], image[1, 0] = (255, 0, 0), (0, 255, 0), (0, 0, 255)
    cv2.imwrite(str(path), image[..., ::-1])
    return path


def test_a_picture_lies_the_right_way_up(tmp_path: Path) -> None:
    floor = FloorSettings(material="image", image=str(picture(tmp_path / "p.png")), image_width=4.0)
    seen = floor.colours_at([(0.5, 1.5), (3.5, 1.5), (0.5, 0.5), (4.5, 3.5), (-3.5, -0.5)]).tolist()
    assert seen == [[255, 0, 0], [0, 255, 0], [0, 0, 255], [255, 0, 0], [255, 0, 0]]


def as_pgm(content: bytes) -> bytes:
    return cv2.imencode(".pgm", cv2.imdecode(np.frombuffer(content, np.uint8), 0))[1].tobytes()


def test_a_picture_that_cannot_be_read_is_refused(
    tmp_path: Path, table: dict[str, Any], capfd: pytest.CaptureFixture[str]
) -> None:
    path = picture(tmp_path / "p.png")
    good, grey = path.read_bytes(), as_pgm(path.read_bytes())
    spoilt = good[:-20] + b"x" + good[-19:]
    for content in (None, b"", b"not a picture", good[:30], good[: len(good) // 2], spoilt, grey[: len(grey) // 2]):
        path.unlink() if content is None else path.write_bytes(content)
        with pytest.raises(ConfigError) as caught:
            parse_scenario({**table, "floor": {"material": "image", "image": str(path)}}, file="s.toml")
        assert (caught.value.file, caught.value.field) == ("s.toml", "floor.image")
    assert capfd.readouterr().err == ""
