"""Maps as files: map_server's greys have its meaning, arrays and rasters read back, and nonsense is refused."""

import re
import warnings
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml
from refusals import refusal

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.formats.map_server import read_map, read_occupancy, write_picture
from moteslam.robot.raster import Raster, read_map_arrays, write_map_arrays

THRESHOLDS = {"occupied_thresh": 0.65, "free_thresh": 0.196}
GREYS = np.array([[254, 206, 205, 204, 100, 90, 89, 0]], np.uint8)


def written(folder: Path, pixels: np.ndarray = GREYS, picture: str = "m.png", **changes: Any) -> Path:
    """A map of those greys or of other pixels, as other programs write them."""
    assert cv2.imwrite(str(folder / picture), pixels)
    about = {"image": picture, "resolution": 0.1, "origin": [1, -2.5, 0.3], "negate": 0, **THRESHOLDS, **changes}
    (folder / "m.yaml").write_text(yaml.safe_dump({key: value for key, value in about.items() if value is not None}))
    return folder / "m.yaml"


def test_a_picture_lies_the_right_way_up_with_its_colours(tmp_path: Path) -> None:
    values = np.zeros((2, 3, 4), np.uint8)
    values[0, 0], values[1, 2] = (255, 0, 0, 255), (0, 0, 200, 100)
    write_picture(tmp_path / "p.png", Raster(values, 0.5, (1.0, 2.0, 0.0)), {"frames": 3})
    image = cv2.imread(str(tmp_path / "p.png"), cv2.IMREAD_UNCHANGED)
    assert image[1, 0].tolist() == [0, 0, 255, 255]  # OpenCV has blue first
    assert image[0, 2].tolist() == [200, 0, 0, 100]
    about = yaml.safe_load((tmp_path / "p.yaml").read_text())
    assert about == {"image": "p.png", "resolution": 0.5, "origin": [1.0, 2.0, 0.0], "frames": 3}


REFUSED = [
    *({key: None} for key in ("image", "resolution", "origin", "negate", "occupied_thresh", "free_thresh")),
    {"mode": "best"},
    {"negate": "maybe"},
    {"occupied_thresh": 1.5},
    {"free_thresh": 0.7},
    {"resolution": True},
    {"origin": [0, 0, float("nan")]},
    {"origin": [0, 0]},
    {"origin": [0, 0, 90]},
    {"resolution": 5},
    {"image": "nothing.pgm"},
    {"image": "bad\0name"},
    {"image": 7},
    {"image": "../m.png"},
    {"image": "link.png"},
    {"image": "/etc/hostname"},
]


@pytest.mark.parametrize("changes", REFUSED)
def test_nonsense_is_refused(tmp_path: Path, changes: dict[str, Any]) -> None:
    (tmp_path / "maps").mkdir()
    (tmp_path / "maps" / "link.png").symlink_to(tmp_path / "m.png")
    path, (field,) = written(tmp_path / "maps", **changes), changes
    with refusal(InputError, "expected", file=path, field=field):
        read_map(path)


@pytest.mark.parametrize(
    "content",
    [
        b"P5\n2 2\n255\n\0\0\0",
        b"P5\n2 2\n0\n\0\0\0\0",
        b"P5\n2 0\n255\n",
        b"P2\n2 2\n255\n1 2 3",
        b"P2\n2 2\n255\n1 2 3 " + 3_000_000 * b"9",
        b"P6\n2 2\n255\n" + bytes(11),
        b"",
    ],
)
def test_a_broken_image_is_refused(tmp_path: Path, content: bytes) -> None:
    path = written(tmp_path)
    (tmp_path / "m.png").write_bytes(content)
    with refusal(InputError, file=tmp_path / "m.png"):
        read_map(path)


def test_for_an_image_without_its_yaml_the_keys_are_named(tmp_path: Path) -> None:
    written(tmp_path)
    with pytest.raises(InputError, match=r"expected a map_server .yaml file \(image, resolution, origin, negate, "):
        read_map(tmp_path / "m.png")


def test_an_outsized_image_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = written(tmp_path, image="huge.pgm")
    (tmp_path / "huge.pgm").write_bytes(b"P5\n# 3 4\n100000 100000\n255\n")
    with pytest.raises(InputError, match="100000 x 100000 pixels, expected at most 64000000"):
        read_map(path)


@pytest.mark.parametrize(
    ("greys", "changes", "words"),
    [
        ([0, 205, 254], {"free_thresh": 0.25}, "grey 205, which map_saver writes for unknown, is read as free"),
        ([205, 254], {"free_thresh": 0.2, "picture": "m.pgm"}, "3 of 6 cells count as known: set free_thresh 0.196, "),
        ([0, 205, 254], {"negate": 1}, "grey 205, which map_saver writes for unknown, is read as occupied"),
        (
            [255, 50, 1],
            {"negate": 1, "free_thresh": 0.25},
            "grey 50, which map_saver writes for unknown, is read as free",
        ),
        ([0, 205, 254], {}, ""),
        ([0, 205, 254], {"free_thresh": 0.0}, "free_thresh 0, occupied_thresh 0.65: its black or its white"),
        ([205, 254], {"occupied_thresh": 1.0}, ""),  # a map of nothing but free space
        ([0, 100, 205, 254], {"free_thresh": 0.25}, ""),  # other greys: a map of somebody else
        ([0, 205, 254], {"free_thresh": 0.25, "mode": "raw"}, "6 of 9 cells have greys from 101 to 254"),
        ([0, 207, 254], {}, "grey 207, next to 205, which map_saver writes for unknown, is read as free"),
        ([0, 206, 205, 254], {}, "grey 206, next to 205, which map_saver writes for unknown, is read as free"),
    ],
)
def test_thresholds_that_make_known_what_map_saver_calls_unknown(
    tmp_path: Path, greys: list[int], changes: dict[str, Any], words: str
) -> None:
    path = written(tmp_path, np.repeat(np.array([greys], np.uint8), 3, axis=1), **changes)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_map(path)
        read_occupancy(path)
    assert len(caught) == (2 if words else 0)
    assert all(words in str(one.message) and issubclass(one.category, MoteslamWarning) for one in caught)
    for one in caught[: words.startswith(("grey", "3 of 6"))]:  # what it says to set mends it
        said = re.search(r"set free_thresh (\S+), occupied_thresh (\S+), negate (\d):", str(one.message))
        mended = {"free_thresh": float(said[1]), "occupied_thresh": float(said[2]), "negate": int(said[3])}
        read_map(written(tmp_path, np.repeat(np.array([greys], np.uint8), 3, axis=1), **changes | mended))


def test_the_mode_scale_makes_free_what_map_saver_calls_unknown(tmp_path: Path) -> None:
    """As map_server publishes it, 0 of 100; cells of three values have unknown there."""
    path = written(tmp_path, np.repeat(np.array([[0, 205, 254]], np.uint8), 3, axis=1), mode="scale")
    assert (read_map(path).values == -1).sum() == 3
    with pytest.warns(MoteslamWarning, match="grey 205, .* is read as free .* set mode trinary, free_thresh 0.196"):
        assert (read_occupancy(path).values == 0).sum() == 6


PIXELS = {
    "transparent black": (
        [(0, 0, 0, 0), (255, 255, 255, 255)],
        np.uint8,
        "3 of 6 cells are transparent, most .* occupied",
    ),
    "transparent white": ([(255, 255, 255, 0), (255, 255, 255, 255)], np.uint8, ""),
    "light green": ([(144, 238, 144), (0, 0, 0)], np.uint8, "3 of 6 cells are coloured, most are read as unknown"),
    "red": ([(0, 0, 255), (255, 255, 255)], np.uint8, "3 of 6 cells are coloured, most are read as occupied"),
    "8 of 16 bits": ([0, 254], np.uint16, "none is brighter than 254 of 65535: all count as black"),
}


@pytest.mark.parametrize("name", PIXELS)
def test_pixels_that_are_hardly_meant_as_they_are_read(tmp_path: Path, name: str) -> None:
    colours, kind, words = PIXELS[name]
    path = written(tmp_path, np.repeat(np.array([colours], kind), 3, axis=1))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        read_map(path)
    assert len(caught) == (1 if words else 0)
    assert all(re.search(words, str(one.message)) for one in caught)


@pytest.mark.parametrize("name", ["/home/somebody/maps/m.png", "C:\\maps\\m.png", "/m.png"])
def test_of_an_absolute_path_elsewhere_the_name_beside_is_read(tmp_path: Path, name: str) -> None:
    path = written(tmp_path, image=name)
    with pytest.warns(MoteslamWarning, match="is not in its folder, 'm.png' beside it is taken"):
        assert read_map(path).shape == (1, 8)
    (tmp_path / "m.png").unlink()
    with pytest.raises(InputError, match="image: "):
        read_map(path)


PLACE = (0.1 + 0.2, (1 / 3, -2.0, 0.5))
RNG = np.random.default_rng(0)


@pytest.mark.parametrize(
    ("name", "values"),
    [
        ("log_odds", RNG.normal(0, 9, (5, 7)).astype(np.float32)),
        ("colours", RNG.integers(0, 256, (5, 7, 3), np.uint8)),
        ("points", RNG.integers(0, 2**32, (1, 1), np.uint32)),
    ],
)
def test_a_map_reads_back_bit_for_bit_and_is_the_same_bytes_again(tmp_path: Path, name: str, values: Any) -> None:
    one, two = tmp_path / "one.npz", tmp_path / "two.npz"
    write_map_arrays(one, {name: Raster(values, *PLACE), "more": Raster(np.ones((2, 2)), *PLACE)})
    again = read_map_arrays(one, name)
    assert (again.cell_size, again.origin) == PLACE
    assert again.values.dtype == values.dtype
    assert again.values.tobytes() == values.tobytes()
    with pytest.raises(ValueError, match="read-only"):
        again.values[0, 0] = 2
    write_map_arrays(two, {name: again, "more": read_map_arrays(one, "more")})
    assert one.read_bytes() == two.read_bytes()


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"log_odds": np.full((2, 3), np.nan)}, "log_odds"),
        ({"log_odds": np.ones((2, 3, 3))}, "log_odds"),
        ({"log_odds": np.ones((0, 3))}, "log_odds"),
        ({"log_odds": np.array([["a"]])}, "log_odds"),
        ({"cell_size": 0}, "cell_size"),
        ({"cell_size": np.nan}, "cell_size"),
        ({"cell_size": [0.1, 0.1]}, "cell_size"),
        ({"origin": (0.0, 0.0)}, "origin"),
        ({"origin": (0.0, 0.0, 1e7)}, "origin"),
        ({"origin": (0.0, 0.0, np.nan)}, "origin"),
    ],
)
def test_a_map_that_is_none_is_refused(tmp_path: Path, changes: dict[str, Any], field: str) -> None:
    path = tmp_path / "m.npz"
    np.savez(path, **{"log_odds": np.ones((2, 3)), "cell_size": 0.1, "origin": (0.0, 0.0, 0.0), **changes})
    with refusal(InputError, file=path, field=field):
        read_map_arrays(path)


VALUES = np.arange(6).reshape(2, 3)
TURNED = Raster(VALUES, 0.5, (1.0, 2.0, np.pi / 2))
"""Its columns run along y, its rows against x."""


def test_centres_and_corners_of_a_turned_raster() -> None:
    np.testing.assert_allclose(TURNED.centres([(0, 0), (1, 2)]), [(0.75, 2.25), (0.25, 3.25)])
    np.testing.assert_allclose(TURNED.to_world([(0, 0), (3, 2)]), [(1.0, 2.0), (0.0, 3.5)], atol=1e-12)
    assert TURNED.shape == (2, 3)


def test_values_are_found_where_the_centres_are_and_nowhere_else() -> None:
    cells = np.argwhere(VALUES >= 0)
    np.testing.assert_array_equal(TURNED.values_at(TURNED.centres(cells), outside=-1), VALUES.ravel())
    beyond = TURNED.to_world([(-0.1, 1.0), (3.1, 1.0), (1.0, -0.1), (1.0, 2.1)])
    np.testing.assert_array_equal(TURNED.values_at(beyond, outside=-1), [-1] * 4)


def test_colours_have_a_row_each() -> None:
    picture = Raster(np.arange(12, dtype=np.uint8).reshape(2, 2, 3), 1.0)
    np.testing.assert_array_equal(picture.values_at([(1.5, 0.5), (9.0, 9.0)], outside=7), [(3, 4, 5), (7, 7, 7)])


@pytest.mark.parametrize(("shape", "cell_size"), [((2,), 1.0), ((2, 2), 0.0), ((2, 2), float("nan"))])
def test_what_is_no_raster_is_refused(shape: tuple[int, ...], cell_size: float) -> None:
    with pytest.raises(InputError, match="expected"):
        Raster(np.zeros(shape), cell_size)
