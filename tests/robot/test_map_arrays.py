"""Maps as arrays: what is written reads back, and nonsense is refused."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

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
    with pytest.raises(InputError) as caught:
        read_map_arrays(path)
    assert (caught.value.file, caught.value.field) == (str(path), field)
