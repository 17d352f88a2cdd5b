"""Maps as arrays with a JSON header: what is written reads back, and nonsense is refused."""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from moteslam.errors import InputError
from moteslam.robot.raster import ARRAYS, MapArrays, read_map_arrays, write_map_arrays

SIZES = st.tuples(st.integers(1, 6), st.integers(1, 6))
PLACES = st.floats(-1e6, 1e6, allow_subnormal=False)


@st.composite
def maps(draw: st.DrawFn) -> MapArrays:
    """Maps of every kind."""
    kind, size = draw(st.sampled_from(sorted(ARRAYS))), draw(SIZES)
    truncation = draw(st.floats(1e-3, 10)) if kind == "tsdf" else None
    found = {}
    for name, about in ARRAYS[kind].items():
        dtype = np.dtype(about.dtype)
        most = np.float32(truncation or 50)
        elements: Any = {"elements": st.floats(-float(most), float(most), width=32, allow_subnormal=False)}
        found[name] = draw(arrays(dtype, (*size, *about.depth), **(elements if dtype.kind == "f" else {})))
    origin = (draw(PLACES), draw(PLACES), draw(PLACES))
    return MapArrays(kind=kind, arrays=found, cell_size=draw(st.floats(1e-3, 10)), origin=origin, truncation=truncation)


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
    assert again.truncation == given_map.truncation
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


TSDF = {"distance": np.zeros((2, 2)), "weight": np.ones((2, 2), int)}


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"kind": "grey"}, "kind: 'grey', expected one of log_odds, tsdf, texture"),
        ({"arrays": {}}, "arrays: none, expected log_odds"),
        ({"arrays": {"log_odds": np.ones(3)}}, r"log_odds: float64\[3\], expected numbers \[H, W\]"),
        ({"arrays": {"log_odds": np.ones((0, 3))}}, r"log_odds: float64\[0, 3\], expected numbers"),
        ({"arrays": {"log_odds": np.full((1, 1), np.nan)}}, "log_odds: expected finite values from"),
        ({"arrays": {"log_odds": np.full((1, 1), np.inf)}}, "log_odds: expected finite values from"),
        ({"arrays": {"log_odds": np.array([["a"]])}}, "log_odds: <U1.*expected numbers"),
        ({"cell_size": 0}, r"cell_size: 0, expected a positive length"),
        ({"cell_size": float("nan")}, r"cell_size: nan, expected a positive length"),
        ({"origin": (0.0, 0.0)}, r"origin: \(0.0, 0.0\), expected three numbers"),
        ({"origin": (0.0, 0.0, 1e7)}, "origin: .*expected three numbers"),
        ({"truncation": 0.1}, "truncation: 0.1, expected none of the kind log_odds"),
        ({"kind": "tsdf", "arrays": TSDF}, "truncation: None, expected a positive length"),
        ({"kind": "tsdf", "arrays": {**TSDF, "weight": np.ones((2, 3))}, "truncation": 1}, r"weight: .*\[2, 3\]"),
        ({"kind": "tsdf", "arrays": {**TSDF, "weight": np.full((2, 2), -1)}, "truncation": 1}, "weight: .*from 0 to"),
        (
            {"kind": "tsdf", "arrays": {**TSDF, "distance": np.full((2, 2), 1.1)}, "truncation": 1},
            "distance: expected finite values from -1 to 1",
        ),
    ],
)
def test_a_map_that_is_none_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        log_odds(**changes)


HEADER = {"format": "moteslam-map", "version": 1, "kind": "log_odds", "cell_size": 0.1, "origin": [0, 0, 0]}


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ({"version": 2}, "header.version: 2, expected 1: a newer moteslam reads"),
        ({"version": True}, "header.version: True, expected 1"),
        ({"format": "grid"}, 'header: expected JSON with "format": "moteslam-map"'),
        ({"kind": "grey"}, "header.kind: 'grey', expected one of"),
        ({"kind": ["log_odds"]}, "header.kind: .*expected one of"),
        ({"kind": "tsdf"}, "distance: missing"),
        ({"cell_size": None}, "header.cell_size: None, expected a positive length"),
        ({"cell_size": 10**400}, "header.cell_size: 10+.*expected a positive length"),
        ({"origin": [0, 0]}, r"header.origin: \(0, 0\), expected three numbers"),
        ({"origin": [0, 0, float("nan")]}, "header.origin: .*expected three numbers"),
        (b"{", "header: expected JSON"),
        (b"[" * 50_000, "header: expected JSON"),
        (b"\xff", "header: expected JSON"),
        (b" " * 200_000, "bytes of arrays, expected at most 100000"),
    ],
)
def test_a_header_that_is_none_is_refused(tmp_path: Path, header: Any, message: str) -> None:
    content = header if isinstance(header, bytes) else json.dumps({**HEADER, **header}).encode()
    path = tmp_path / "m.npz"
    np.savez(path, header=np.frombuffer(content, np.uint8), log_odds=np.ones((2, 2), np.float32))
    with pytest.raises(InputError, match=message) as caught:
        read_map_arrays(path)
    assert str(caught.value).startswith(str(path))
    assert "\n" not in str(caught.value)


def test_more_keys_are_passed_over(tmp_path: Path) -> None:
    content = np.frombuffer(json.dumps({**HEADER, "made": "today"}).encode(), np.uint8)
    np.savez(tmp_path / "m.npz", header=content, log_odds=np.ones((2, 2)), more=np.ones(3))
    assert read_map_arrays(tmp_path / "m.npz").raster("log_odds").shape == (2, 2)
