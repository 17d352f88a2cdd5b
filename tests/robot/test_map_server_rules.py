"""Maps of map_server, cell by cell as its rules have them: every mode, threshold, channel and kind of image."""

from __future__ import annotations

import math
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from map_server_rules import Meaning, Pixel, nav2_cell, ros1_cell, saved_cell, trinary_cell
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.robot.formats.map_server import (
    occupancy_of,
    read_map,
    read_occupancy,
    write_map,
    write_occupancy,
)
from moteslam.robot.raster import Raster

pytestmark = pytest.mark.filterwarnings("ignore:.*which map_saver writes for unknown")

SIZES = st.tuples(st.integers(1, 5), st.integers(1, 5))
THRESHOLDS = st.sampled_from((0.0, 0.1, 0.196, 50 / 255, 0.2, 0.25, 0.5, 0.65, 0.8, 1.0))
MEANINGS = st.builds(
    lambda mode, negate, one, other: Meaning(mode, negate, max(one, other), min(one, other)),
    st.sampled_from(("trinary", "scale", "raw")),
    st.booleans(),
    THRESHOLDS,
    THRESHOLDS,
)
PLACES = st.tuples(
    st.floats(-50, 50, allow_subnormal=False),
    st.floats(-50, 50, allow_subnormal=False),
    st.floats(-3.2, 3.2, allow_subnormal=False),
)
CELL = 0.25


def numbers(largest: int) -> st.SearchStrategy[int]:
    """Values of a channel: any, and those at its ends and at common greys."""
    common = sorted({0, 1, largest, *(round(grey / 255 * largest) for grey in (50, 51, 89, 100, 101, 204, 205, 254))})
    return st.one_of(st.sampled_from(common), st.integers(0, largest))


def image(channels: int, largest: int) -> st.SearchStrategy[NDArray[np.uint16]]:
    """[H, W, C]."""
    return SIZES.flatmap(
        lambda size: arrays(np.uint16, (*size, channels), elements=numbers(largest))  # type: ignore[no-any-return]
    )


def png(pixels: NDArray[np.uint16], largest: int) -> bytes:
    """As PNG of 8 or 16 bits; OpenCV has blue first."""
    order = {1: [0], 3: [2, 1, 0], 4: [2, 1, 0, 3]}[pixels.shape[2]]
    return bytes(cv2.imencode(".png", pixels[:, :, order].astype(np.uint8 if largest == 255 else np.uint16))[1])


def pgm(pixels: NDArray[np.uint16], largest: int, *, plain: bool) -> bytes:
    """As PGM with comments, P2 (text) or P5 (bytes)."""
    rows, columns, _ = pixels.shape
    head = f"P{2 if plain else 5} # by a test\n{columns}\t{rows} #\n# 7 8 9\n{largest}\n".encode()
    if plain:
        return head + b"\n".join(b" ".join(b"%d" % value for value in row) for row in pixels[..., 0])
    return head + pixels.astype(">u2" if largest > 255 else np.uint8).tobytes()


def written(folder: str, content: bytes, says: Meaning, place: tuple[float, float, float], name: str = "m.png") -> Path:
    (Path(folder) / name).write_bytes(content)
    x, y, yaw = place
    path = Path(folder) / "m.yaml"
    path.write_text(
        f"image: {name}\nresolution: {CELL}\norigin: [{x!r}, {y!r}, {yaw!r}]\nnegate: {int(says.negate)}\n"
        f"occupied_thresh: {says.occupied!r}\nfree_thresh: {says.free!r}\nmode: {says.mode}\n"
    )
    return path


def cells(raster: Raster) -> list[list[int]]:
    """The values, the largest y first, as an image has them."""
    found: list[list[int]] = raster.values[::-1].tolist()
    return found


def rows_of(pixels: NDArray[np.uint16]) -> list[list[Pixel]]:
    return [[tuple(pixel) for pixel in row] for row in pixels.tolist()]


@settings(max_examples=80, deadline=None)
@given(st.data(), st.sampled_from(((1, 255), (1, 65535), (3, 255), (3, 65535), (4, 255), (4, 65535))), MEANINGS, PLACES)
def test_a_png_is_read_as_map_server_reads_it(
    data: st.DataObject, kind: tuple[int, int], says: Meaning, place: tuple[float, float, float]
) -> None:
    channels, largest = kind
    pixels = data.draw(image(channels, largest))
    with tempfile.TemporaryDirectory() as folder:
        path = written(folder, png(pixels, largest), says, place)
        nav2, ros1, trinary = read_occupancy(path), read_occupancy(path, rules="ros1"), read_map(path)
    rows = rows_of(pixels)
    assert cells(nav2) == [[nav2_cell(pixel, largest, says) for pixel in row] for row in rows]
    assert cells(trinary) == [[trinary_cell(pixel, largest, says) for pixel in row] for row in rows]
    bytes_of = rows_of(pixels if largest == 255 else pixels >> 8)
    assert cells(ros1) == [[ros1_cell(pixel, says) for pixel in row] for row in bytes_of]
    assert nav2.values.dtype == np.int8
    assert (nav2.cell_size, nav2.origin) == (CELL, place)


@settings(max_examples=80, deadline=None)
@given(st.data(), st.sampled_from((1, 2, 100, 254, 255, 256, 1000, 65535)), st.booleans(), MEANINGS)
def test_a_pgm_is_read_whatever_its_largest_value(
    data: st.DataObject, largest: int, plain: bool, says: Meaning
) -> None:
    pixels = data.draw(image(1, largest))
    with tempfile.TemporaryDirectory() as folder:
        path = written(folder, pgm(pixels, largest, plain=plain), says, (0.0, 0.0, 0.0), "m.pgm")
        found = cells(read_occupancy(path))
    assert found == [[nav2_cell(pixel, largest, says) for pixel in row] for row in rows_of(pixels)]


def test_a_probability_of_just_the_threshold_has_rounding_on_its_side(tmp_path: Path) -> None:
    """1 - 204 / 255 is below 0.2 to a float64, and (255 - 204) / 255 is not; 102 / 255 is 0.4 to both."""
    path = written(str(tmp_path), png(np.array([[[204], [153]]]), 255), Meaning("trinary", False, 0.4, 0.2), (0, 0, 0))
    assert read_occupancy(path).values.tolist() == [[0, -1]]
    assert read_occupancy(path, rules="ros1").values.tolist() == [[-1, -1]]


@settings(max_examples=50, deadline=None)
@given(st.data(), PLACES)
def test_a_turned_map_lies_about_its_lower_left_corner(data: st.DataObject, place: tuple[float, float, float]) -> None:
    pixels = data.draw(image(1, 255))
    rows, columns, _ = pixels.shape
    row, column = data.draw(st.integers(0, rows - 1)), data.draw(st.integers(0, columns - 1))
    with tempfile.TemporaryDirectory() as folder:
        found = read_occupancy(written(folder, png(pixels, 255), Meaning("raw", False, 0.65, 0.196), place))
    x, y, yaw = place
    right, up = CELL * (column + 0.5), CELL * (rows - row - 0.5)
    point = (x + right * math.cos(yaw) - up * math.sin(yaw), y + right * math.sin(yaw) + up * math.cos(yaw))
    grey = int(pixels[row, column, 0])
    assert found.values_at([point], outside=77).tolist() == [grey if grey <= 100 else -1]


@settings(max_examples=100, deadline=None)
@given(st.data(), MEANINGS)
def test_occupancies_are_written_as_map_saver_writes_them(data: st.DataObject, says: Meaning) -> None:
    percent = data.draw(arrays(np.int8, SIZES, elements=st.integers(-1, 100)))
    says = says._replace(negate=False)
    with tempfile.TemporaryDirectory() as folder:
        path, raster = Path(folder) / "m.png", Raster(percent, CELL)
        write_occupancy(path, raster, mode=says.mode, thresholds=(says.occupied, says.free))  # type: ignore[arg-type]
        found = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert found is not None
    expected = [[saved_cell(value, says) for value in row] for row in percent[::-1].tolist()]
    if found.ndim == 2:
        assert [[(value,) for value in row] for row in found.tolist()] == expected
    else:  # with opacity: every pixel has it
        opaque = [[pixel if len(pixel) == 4 else (*3 * pixel, 255) for pixel in row] for row in expected]
        assert rows_of(found) == opaque


@settings(max_examples=60, deadline=None)
@given(
    arrays(np.int8, SIZES, elements=st.integers(-1, 100)),
    st.sampled_from((("raw", False, 0.65, 0.196), ("scale", False, 1.0, 0.0), ("scale", True, 1.0, 0.0))),
    st.sampled_from((".png", ".pgm")),
)
def test_occupancies_read_back(percent: NDArray[np.int8], how: tuple[str, bool, float, float], ending: str) -> None:
    mode, negate, *thresholds = how
    if mode == "scale" and ending == ".pgm":
        percent = np.abs(percent)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"m{ending}"
        raster = Raster(percent, CELL, (1.0, -2.0, 0.5))
        write_occupancy(path, raster, mode=mode, negate=negate, thresholds=(thresholds[0], thresholds[1]))  # type: ignore[arg-type]
        found = read_occupancy(path.with_suffix(".yaml"))
    np.testing.assert_array_equal(found.values, percent)
    assert (found.cell_size, found.origin) == (CELL, (1.0, -2.0, 0.5))


@settings(max_examples=60, deadline=None)
@given(arrays(np.int8, SIZES, elements=st.integers(-1, 1)), st.sampled_from(("trinary", "scale", "raw")), st.booleans())
def test_a_trinary_map_reads_back_in_every_mode(values: NDArray[np.int8], mode: str, negate: bool) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "m.png"
        write_map(path, Raster(values, CELL), mode=mode, negate=negate and mode != "raw")  # type: ignore[arg-type]
        np.testing.assert_array_equal(read_map(path.with_suffix(".yaml")).values, values)


def test_log_odds_become_percent() -> None:
    log_odds = np.array([[0.0, np.log(4), -np.log(4)], [1000.0, -1000.0, np.nan]], np.float32)
    found = occupancy_of(Raster(log_odds, 0.1, (1.0, 2.0, 3.0)))
    assert found.values.tolist() == [[-1, 80, 20], [100, 0, -1]]
    assert (found.cell_size, found.origin) == (0.1, (1.0, 2.0, 3.0))


@pytest.mark.parametrize(
    ("name", "values", "options", "error", "message"),
    [
        ("m.bmp", [[0]], {}, OutputError, r"m\.bmp: expected a name that ends in \.pgm or \.png"),
        ("m.png", [[101]], {}, InputError, r"raster: int8\[1, 1\], expected whole values of -1 to 100"),
        ("m.png", [[-2]], {}, InputError, "expected whole values of -1 to 100"),
        ("m.png", [[0]], {"negate": True}, InputError, "negate: true with the mode raw"),
        ("m.png", [[0]], {"mode": "grey"}, ConfigError, "mode: 'grey', expected trinary, scale, raw"),
        ("m.png", [[0]], {"thresholds": (0.2, 0.6)}, ConfigError, "thresholds: .*the larger first"),
        ("m.pgm", [[-1]], {"mode": "scale"}, OutputError, r"has no transparency .* expected a \.png"),
    ],
)
def test_what_cannot_be_written_is_refused(tmp_path, name, values, options, error, message) -> None:
    with pytest.raises(error, match=message):
        write_occupancy(tmp_path / name, Raster(np.array(values, np.int8), 0.1), **options)
    assert not list(tmp_path.iterdir())


def test_rules_of_somebody_else_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="rules: 'mine', expected nav2 or ros1"):
        read_occupancy(tmp_path / "m.yaml", rules="mine")  # type: ignore[arg-type]
    with pytest.raises(InputError, match=r"log_odds: int8\[1, 1\], expected floats"):
        occupancy_of(Raster(np.zeros((1, 1), np.int8), 0.1))
