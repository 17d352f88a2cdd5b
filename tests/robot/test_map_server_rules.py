"""Maps of map_server, cell by cell as its rules have them: every mode, threshold, channel and kind of image."""

import math
import tempfile
from math import floor
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from numpy.typing import NDArray

from moteslam.errors import InputError, MoteslamError, OutputError
from moteslam.robot.formats.map_server import read_map, read_occupancy, write_map
from moteslam.robot.raster import Raster

Pixel = tuple[int, ...]
"""The channels of a pixel: grey, or red, green and blue, or these and opacity."""


class Meaning(NamedTuple):
    """What the YAML file says of the greys."""

    mode: str
    negate: bool
    occupied: float
    free: float


def shade_of(pixel: Pixel, largest: int, says: Meaning) -> float:
    """From black, 0, to white, 1: all channels averaged, or but the opacity; of numbers as the file has them."""
    quanta = [(2 * 65535 * number + largest) // (2 * largest) for number in pixel]
    averaged = quanta if says.mode == "trinary" else quanta[:3]
    return sum(averaged) / len(averaged) / 65535


def nav2_cell(pixel: Pixel, largest: int, says: Meaning) -> int:
    """The occupancy that nav2 publishes, -1 or 0 to 100."""
    shade = shade_of(pixel, largest, says)
    if says.mode == "raw":
        number = floor(shade * 255 + 0.5)
        return number if number <= 100 else -1
    occupancy = shade if says.negate else 1.0 - shade
    if says.mode == "scale" and pixel[3:] not in ((), (largest,)):
        return -1
    if says.occupied < occupancy:
        return 100
    if occupancy < says.free:
        return 0
    if says.mode == "trinary" or says.occupied == says.free:
        return -1
    return round((occupancy - says.free) / (says.occupied - says.free) * 100.0)


def trinary_cell(pixel: Pixel, largest: int, says: Meaning) -> int:
    """Free (0), occupied (1) or unknown (-1): what is beyond the thresholds, of the mode raw as map_saver has it."""
    if says.mode == "raw":
        percent = nav2_cell(pixel, largest, says)
        if 0 <= percent <= round(100 * says.free):
            return 0
        return 1 if percent >= round(100 * says.occupied) else -1
    if says.mode == "scale" and pixel[3:] not in ((), (largest,)):
        return -1
    shade = shade_of(pixel, largest, says)
    occupancy = shade if says.negate else 1.0 - shade
    if occupancy > says.occupied:
        return 1
    return 0 if occupancy < says.free else -1


pytestmark = pytest.mark.filterwarnings("ignore::moteslam.errors.MoteslamWarning")

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
    return SIZES.flatmap(lambda size: arrays(np.uint16, (*size, channels), elements=numbers(largest)))


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
        nav2, trinary = read_occupancy(path), read_map(path)
    rows = rows_of(pixels)
    assert cells(nav2) == [[nav2_cell(pixel, largest, says) for pixel in row] for row in rows]
    assert cells(trinary) == [[trinary_cell(pixel, largest, says) for pixel in row] for row in rows]
    assert nav2.values.dtype == np.int8
    assert (nav2.cell_size, nav2.origin) == (CELL, place)


@given(st.data(), st.sampled_from((255, 65535)), st.booleans(), MEANINGS)
def test_a_pgm_is_read(data: st.DataObject, largest: int, plain: bool, says: Meaning) -> None:
    pixels = data.draw(image(1, largest))
    with tempfile.TemporaryDirectory() as folder:
        path = written(folder, pgm(pixels, largest, plain=plain), says, (0.0, 0.0, 0.0), "m.pgm")
        found = cells(read_occupancy(path))
    assert found == [[nav2_cell(pixel, largest, says) for pixel in row] for row in rows_of(pixels)]


def test_a_probability_of_just_the_threshold_has_rounding_on_its_side(tmp_path: Path) -> None:
    """1 - 204 / 255 is below 0.2 to a float64; 102 / 255 is 0.4."""
    path = written(str(tmp_path), png(np.array([[[204], [153]]]), 255), Meaning("trinary", False, 0.4, 0.2), (0, 0, 0))
    assert read_occupancy(path).values.tolist() == [[0, -1]]


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


@given(arrays(np.int8, SIZES, elements=st.integers(-1, 1)), st.sampled_from((".png", ".pgm", ".yaml")))
def test_a_map_reads_back(values: NDArray[np.int8], ending: str) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / f"m{ending}"
        write_map(path, Raster(values, CELL, (1.0, -2.0, 0.5)))
        found = read_map(path.with_suffix(".yaml"))
    np.testing.assert_array_equal(found.values, values)
    assert (found.cell_size, found.origin) == (CELL, (1.0, -2.0, 0.5))


@pytest.mark.parametrize(("name", "value", "error"), [("m.bmp", 0, OutputError), ("m.png", 2, InputError)])
def test_what_cannot_be_written_is_refused(tmp_path: Path, name: str, value: int, error: type[MoteslamError]) -> None:
    with pytest.raises(error, match=r"dataclasses.replace\(raster, values=.*\.trinary\(raster\.values\)\)|pgm"):
        write_map(tmp_path / name, Raster(np.full((1, 1), value, np.int8), 0.1))
    assert not list(tmp_path.iterdir())
