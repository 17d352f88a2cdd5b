"""map_server's files: what is written reads back, greys have map_server's meaning, and nonsense is refused."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from moteslam.errors import InputError, OutputError
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN, read_map, write_map, write_picture
from moteslam.robot.raster import Raster

GREYS = np.array([[254, 206, 205, 204, 100, 90, 89, 0]], np.uint8)


def written(folder: Path, **changes: Any) -> Path:
    """A map of those greys, as other programs write them."""
    assert cv2.imwrite(str(folder / "m.png"), GREYS)
    about = {"image": "m.png", "resolution": 0.1, "origin": [1, -2.5, 0.3], "negate": 0, **changes}
    (folder / "m.yaml").write_text(yaml.safe_dump(about))
    return folder / "m.yaml"


@pytest.mark.parametrize("name", ["map.pgm", "no: comment #1, é.pgm"])
def test_a_map_reads_back(tmp_path: Path, name: str) -> None:
    try:
        os.fsencode(name)
    except UnicodeEncodeError:
        pytest.skip("the locale's encoding has no such letter")
    values = np.random.default_rng(0).choice((FREE, OCCUPIED, UNKNOWN), (5, 7)).astype(np.int8)
    write_map(tmp_path / name, Raster(values, 0.05, (-1e-5, 2.25, -3.0)))
    back = read_map((tmp_path / name).with_suffix(".yaml"))
    np.testing.assert_array_equal(back.values, values)
    assert (back.cell_size, back.origin) == (0.05, (-1e-5, 2.25, -3.0))
    assert (tmp_path / name).read_bytes()[:11] == b"P5\n7 5\n255\n"


def test_a_picture_lies_the_right_way_up_with_its_colours(tmp_path: Path) -> None:
    values = np.zeros((2, 3, 4), np.uint8)
    values[0, 0], values[1, 2] = (255, 0, 0, 255), (0, 0, 200, 100)
    write_picture(tmp_path / "p.png", Raster(values, 0.5, (1.0, 2.0, 0.0)), {"frames": 3})
    image = cv2.imread(str(tmp_path / "p.png"), cv2.IMREAD_UNCHANGED)
    assert image is not None
    assert image[1, 0].tolist() == [0, 0, 255, 255]  # OpenCV has blue first
    assert image[0, 2].tolist() == [200, 0, 0, 100]
    about = yaml.safe_load((tmp_path / "p.yaml").read_text())
    assert about == {"image": "p.png", "resolution": 0.5, "origin": [1.0, 2.0, 0.0], "frames": 3}


@pytest.mark.parametrize(
    ("changes", "values"),
    [
        ({}, [0, 0, -1, -1, -1, -1, 1, 1]),
        ({"mode": "scale"}, [0, 0, -1, -1, -1, -1, 1, 1]),
        ({"negate": 1}, [1, 1, 1, 1, -1, -1, -1, 0]),
        ({"negate": True, "occupied_thresh": 0.9}, [1, -1, -1, -1, -1, -1, -1, 0]),
        ({"occupied_thresh": 0.6, "free_thresh": 0.21}, [0, 0, 0, 0, 1, 1, 1, 1]),
        ({"mode": "raw"}, [-1, -1, -1, -1, 1, 1, 1, 0]),
    ],
)
def test_what_the_greys_mean(tmp_path: Path, changes: dict[str, Any], values: list[int]) -> None:
    found = read_map(written(tmp_path, **changes))
    assert found.values.tolist() == [values]
    assert found.origin == (1.0, -2.5, 0.3)
    assert not found.values.flags.writeable


@pytest.mark.parametrize(
    ("changes", "field", "words"),
    [
        ({"mode": "best"}, "mode", "'best', expected trinary, scale, raw"),
        ({"negate": 2}, "negate", "2, expected 0, 1"),
        ({"occupied_thresh": 1.5}, "occupied_thresh", "1.5, expected a number from 0 to 1"),
        ({"occupied_thresh": 0.1}, "free_thresh", "0.196, expected at most occupied_thresh, 0.1"),
        ({"resolution": True}, "resolution", "True, expected a number"),
        ({"origin": [0, 0, float("nan")]}, "origin", "expected three numbers"),
        ({"image": "nothing.pgm"}, "image", "nothing.pgm: No such file or directory, expected a pgm or png"),
        ({"image": "bad\0name"}, "image", "expected a pgm or png"),
    ],
)
def test_nonsense_is_refused(tmp_path: Path, changes: dict[str, Any], field: str, words: str) -> None:
    path = written(tmp_path, **changes)
    with pytest.raises(InputError, match="expected") as caught:
        read_map(path)
    assert (caught.value.file, caught.value.field) == (str(path), field)
    assert words in caught.value.problem
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"image: [", "not YAML"),
        (b"\xff\xfe", "not UTF-8 text, expected a map_server"),
        (b"- 1\n", "not a table"),
        (b"a: 2001-99-99\n", "not YAML: month must be in"),
        (b"#" * 200_000, "over 0.1 MB"),
        (b"image: m.png\nresolution: 1\n", "missing, expected in every map_server file"),
    ],
)
def test_a_file_that_is_none_is_refused(tmp_path: Path, content: bytes, words: str) -> None:
    (tmp_path / "m.yaml").write_bytes(content)
    with pytest.raises(InputError) as caught:
        read_map(tmp_path / "m.yaml")
    assert words in caught.value.problem
    assert "\n" not in str(caught.value)


def test_an_outsized_image_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = written(tmp_path, image="huge.pgm")
    (tmp_path / "huge.pgm").write_bytes(b"P5\n# 3 4\n100000 100000\n255\n")
    with pytest.raises(InputError, match="100000 x 100000 pixels, expected at most 64000000"):
        read_map(path)


def test_a_missing_folder_is_refused(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match="cannot be written"):
        write_map(tmp_path / "no" / "m.pgm", Raster(np.zeros((2, 2), np.int8), 0.1))
