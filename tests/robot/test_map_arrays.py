"""Maps as arrays with a JSON header: what is written reads back, and nonsense is refused."""

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moteslam.errors import MoteslamError
from moteslam.robot.raster import ARRAYS, MapArrays, read_map_arrays, write_map_arrays

SIZES = st.tuples(st.integers(1, 6), st.integers(1, 6))
PLACES = st.floats(-1e6, 1e6, allow_subnormal=False)


@st.composite
def maps(draw: st.DrawFn) -> MapArrays:
    """Maps of every kind."""
    kind, size = draw(st.sampled_from(sorted(ARRAYS))), draw(SIZES)
    found = {}
    for name, about in ARRAYS[kind].items():
        dtype = np.dtype(about.dtype)
        elements: Any = {"elements": st.floats(-50, 50, width=32, allow_subnormal=False)}
        found[name] = draw(arrays(dtype, (*size, *about.depth), **(elements if dtype.kind == "f" else {})))
    origin = (draw(PLACES), draw(PLACES), draw(PLACES))
    return MapArrays(kind=kind, arrays=found, cell_size=draw(st.floats(1e-3, 10)), origin=origin)


@settings(max_examples=60, deadline=None)
@given(maps())
def test_a_map_reads_back_bit_for_bit_and_is_the_same_bytes_again(given_map: MapArrays) -> None:
    with tempfile.TemporaryDirectory() as folder:
        one, two = Path(folder) / "one.npz", Path(folder) / "two.npz"
        write_map_arrays(one, given_map)
        again = read_map_arrays(one)
        write_map_arrays(two, again)
        same = one.read_bytes() == two.read_bytes()
    assert same
    assert (again.kind, again.cell_size, again.origin) == (given_map.kind, given_map.cell_size, given_map.origin)
    for name, values in given_map.arrays.items():
        assert again.arrays[name].dtype == values.dtype
        assert again.arrays[name].tobytes() == values.tobytes()


def log_odds(**changes: Any) -> MapArrays:
    about: dict[str, Any] = {"kind": "log_odds", "arrays": {"log_odds": np.ones((2, 3))}, "cell_size": 0.1, **changes}
    return MapArrays(**about)


def test_any_reader_of_npz_gets_at_all_of_it(tmp_path: Path) -> None:
    write_map_arrays(tmp_path / "m.npz", log_odds(origin=(1.0, 2.0, 0.5)))
    with np.load(tmp_path / "m.npz", allow_pickle=False) as file:
        assert json.loads(file["header"].tobytes()) == {
            "format": "moteslam-map",
            "version": 1,
            "kind": "log_odds",
            "cell_size": 0.1,
            "origin": [1.0, 2.0, 0.5],
            "units": {"log_odds": "1"},
        }
        assert file["log_odds"].dtype == np.float32
        assert file["log_odds"].tolist() == [[1, 1, 1], [1, 1, 1]]


def test_an_array_of_it_is_a_raster_that_nobody_writes_to() -> None:
    raster = log_odds(origin=(1.0, 2.0, 0.0)).raster("log_odds")
    assert raster.extent == pytest.approx((1.0, 1.3, 2.0, 2.2))
    with pytest.raises(ValueError, match="read-only"):
        raster.values[0, 0] = 2


@pytest.mark.parametrize(
    ("changes", "field"),
    [
        ({"kind": "grey"}, "kind"),
        ({"arrays": {}}, "arrays"),
        ({"arrays": {"log_odds": np.ones(3)}}, "log_odds"),
        ({"arrays": {"log_odds": np.ones((0, 3))}}, "log_odds"),
        ({"arrays": {"log_odds": np.full((1, 1), np.nan)}}, "log_odds"),
        ({"arrays": {"log_odds": np.full((1, 1), np.inf)}}, "log_odds"),
        ({"arrays": {"log_odds": np.array([["a"]])}}, "log_odds"),
        ({"cell_size": 0}, "cell_size"),
        ({"cell_size": float("nan")}, "cell_size"),
        ({"origin": (0.0, 0.0)}, "origin.2"),
        ({"origin": (0.0, 0.0, 1e7)}, "origin.2"),
        ({"kind": "texture", "arrays": {"colours": np.ones((2, 2, 3)), "points": np.ones((2, 3))}}, "points"),
        ({"kind": "texture", "arrays": {"colours": np.ones((2, 2, 3)), "points": np.full((2, 2), -1)}}, "points"),
    ],
)
def test_a_map_that_is_none_is_refused(changes: dict[str, Any], field: str) -> None:
    with pytest.raises(MoteslamError) as caught:
        log_odds(**changes)
    assert caught.value.field == field


HEADER = {"format": "moteslam-map", "version": 1, "kind": "log_odds", "cell_size": 0.1, "origin": [0, 0, 0]}


@pytest.mark.parametrize(
    ("header", "field"),
    [
        ({"version": 2}, "header.version"),
        ({"format": "grid"}, "header.format"),
        ({"kind": "grey"}, "header.kind"),
        ({"kind": ["log_odds"]}, "header.kind"),
        ({"kind": "texture"}, "colours"),
        ({"cell_size": None}, "header.cell_size"),
        ({"cell_size": 10**400}, "header.cell_size"),
        ({"origin": [0, 0]}, "header.origin.2"),
        ({"origin": [0, 0, float("nan")]}, "header.origin.2"),
        (b"{", "header"),
        (b"[" * 50_000, "header"),
        (b"3", "header"),
        (b"\xff", "header"),
        (b" " * 200_000, None),
    ],
)
def test_a_header_that_is_none_is_refused(tmp_path: Path, header: Any, field: str | None) -> None:
    content = header if isinstance(header, bytes) else json.dumps({**HEADER, **header}).encode()
    path = tmp_path / "m.npz"
    np.savez(path, header=np.frombuffer(content, np.uint8), log_odds=np.ones((2, 2), np.float32))
    with pytest.raises(MoteslamError) as caught:
        read_map_arrays(path)
    assert (caught.value.file, caught.value.field) == (str(path), field)
    assert "\n" not in str(caught.value)


def test_more_keys_are_passed_over(tmp_path: Path) -> None:
    content = np.frombuffer(json.dumps({**HEADER, "made": "today"}).encode(), np.uint8)
    np.savez(tmp_path / "m.npz", header=content, log_odds=np.ones((2, 2)), more=np.ones(3))
    assert read_map_arrays(tmp_path / "m.npz").raster("log_odds").shape == (2, 2)
