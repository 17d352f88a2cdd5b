"""`sessions.npz`, and `replay --onto`: what is kept, what is refused, and that nothing is half written."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_lines import printed, refused

from moteslam.errors import InputError
from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.results import BUILDING as NAME
from moteslam.eval.results import read_building, write_building
from moteslam.robot.trajectories.text import read_tum
from moteslam.sim.output import write_simulation
from moteslam.sim.simulate import simulate

Arrays = dict[str, np.ndarray[Any, Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, and the result of its beginning."""
    from moteslam.eval.cli import main

    folder = tmp_path_factory.mktemp("sessions")
    write_simulation(folder / "log", simulate(scenario_of("office", 310, duration=40.0), 310))
    words = ["replay", str(folder / "log"), "--end", "25", "--out", str(folder / "result"), "--no-figures"]
    assert main.run(words) == 0
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.slow
def test_a_result_is_gone_on_with_and_stays_as_it_is(folder: Path, capsys: pytest.CaptureFixture[str]) -> None:
    before = contents(folder / "result")
    onto = ("--onto", folder / "result", "--no-figures")
    printed(capsys, "replay", folder / "log", "--start", 15, *onto, "--out", folder / "both")
    assert contents(folder / "result") == before
    building = read_building(folder / "both")
    assert len(building.sessions) == 2
    assert building.between.any()
    for number, session in enumerate(building.sessions, start=1):
        written = read_tum(folder / "both" / f"session_{number}.tum")
        np.testing.assert_allclose(written.poses, session.path, atol=1e-5)
    final = read_tum(folder / "both" / "trajectory_final.tum")
    np.testing.assert_allclose(final.poses, building.sessions[1].path, atol=1e-5)
    # what was bound is a result to go on with, too
    printed(capsys, "replay", folder / "log", "--onto", folder / "both", "--no-figures", "--out", folder / "three")
    assert len(read_building(folder / "three").sessions) == 3


def test_what_is_read_is_what_was_written(folder: Path, tmp_path: Path) -> None:
    building = read_building(folder / "result")
    write_building(tmp_path / NAME, building)
    again = read_building(tmp_path)
    (one,), (other,) = building.sessions, again.sessions
    for name in ("stamps", "path", "nodes", "points", "counts", "origin", "drawn"):
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name), err_msg=name)
    for mine, its in zip(one.chain, other.chain, strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(building.loops.information, again.loops.information)
    final = read_tum(folder / "result" / "trajectory_final.tum")
    np.testing.assert_allclose(one.path, final.poses, atol=1e-5)
    assert (folder / "result" / NAME).stat().st_size < 10_000 * final.length  # 10 MB a kilometre


def without(name: str) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {key: value for key, value in arrays.items() if key != name}


def put(name: str, change: Callable[[Any], Any]) -> Callable[[Arrays], Arrays]:
    return lambda arrays: {**arrays, name: change(arrays[name])}


@pytest.mark.parametrize(
    ("change", "field"),
    [
        (put("version", lambda version: version + 1), "version"),
        (without("version"), "version"),
        (without("steps"), "steps"),
        (put("path", lambda path: path * np.nan), "path"),
        (put("nodes", lambda nodes: nodes[::-1]), "nodes"),
        (put("nodes", lambda nodes: nodes + 1_000_000), "nodes"),
        (put("sizes", lambda sizes: sizes + 1), "sizes"),
        (put("scans", lambda scans: scans - 1), "scans"),
        (put("counts", lambda counts: counts + 1), "counts"),
        (put("counts", lambda counts: counts.astype(np.float64)), "counts"),
        (put("points", lambda points: points.astype(np.float32)), "points"),
        (put("resolution", lambda _: np.float64(0)), "resolution"),
        (put("covariance", lambda covariance: -covariance), "covariance"),
        (put("prior_steps", lambda steps: steps[1:]), "prior_steps"),
        (put("first", lambda _: np.array([5])), "second"),
    ],
)
def test_a_broken_file_is_refused(folder: Path, tmp_path: Path, change: Callable[[Arrays], Arrays], field: str) -> None:
    with np.load(folder / "result" / NAME) as stored:
        arrays = change(dict(stored))
    np.savez_compressed(tmp_path / NAME, **arrays)
    with pytest.raises(InputError) as caught:
        read_building(tmp_path)
    assert (caught.value.field, Path(str(caught.value.file))) == (field, tmp_path / NAME)


@pytest.mark.parametrize("what", ["version", "missing", "back end"])
def test_what_cannot_be_gone_on_with_is_one_line(
    folder: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], what: str
) -> None:
    old, more = tmp_path / "old", []
    old.mkdir()
    if what == "version":
        np.savez(old / NAME, version=np.int64(9))
    if what == "back end":
        old, more = folder / "result", ["--set", "backend.method=none"]
    line = refused(capsys, "replay", folder / "log", "--onto", old, "--out", tmp_path / "out", *more)
    assert ("--onto" if what == "back end" else str(old / NAME)) in line
    assert not (tmp_path / "out").exists()
