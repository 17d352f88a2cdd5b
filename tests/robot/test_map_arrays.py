"""Maps as arrays, which read back or are refused; and rasters: where their cells lie, turned ones too."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from refusals import refusal

from moteslam.errors import InputError
from moteslam.robot.raster import Raster, read_map_arrays, write_map_arrays

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
