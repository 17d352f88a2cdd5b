"""The result folder of a run, its figures and tables, reading them back, and what a notebook and viewers show."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest
from command_lines import Capsys, printed, refused
from loop_candidates import candidate
from refusals import refusal
from rosbags.highlevel import AnyReader

from moteslam.errors import InputError
from moteslam.eval.cli import main
from moteslam.eval.cli.running import described, run_lines, score_lines
from moteslam.eval.cli.simulate import scenario_of
from moteslam.eval.results import BUILDING as NAME
from moteslam.eval.results import read_building, write_building, write_result_bag, write_results
from moteslam.eval.run_tables import (
    DIAGNOSTICS_COLUMNS,
    LOOP_COLUMNS,
    VALUES,
    VERDICTS,
    read_diagnostics,
    read_loops,
    write_diagnostics,
    write_loops,
)
from moteslam.eval.runs import read_result_folder
from moteslam.eval.scores import evidence_of, number, score_estimate
from moteslam.files import result_folder
from moteslam.robot import se2
from moteslam.robot.formats import open_recording
from moteslam.robot.formats.map_server import trinary
from moteslam.robot.raster import read_map_arrays
from moteslam.robot.trajectories.text import read_g2o, read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.output import write_simulation
from moteslam.sim.simulate import simulate
from moteslam.slam.backend.protocol import BackendConfig, NoBackendConfig
from moteslam.slam.config import resolve_config
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState


def test_what_is_written_is_what_was_estimated(run, simulation, tmp_path: Path) -> None:
    estimate, _ = run
    figures = write_results(tmp_path, estimate, simulation.truth, figures=False, run={"threads": 2})
    for name, trajectory in (
        ("trajectory", estimate.trajectory),
        ("trajectory_final", estimate.trajectory_final),
        ("dead_reckoning", estimate.dead_reckoning),
        ("truth", simulation.truth),
    ):
        back = read_tum(tmp_path / f"{name}.tum")
        np.testing.assert_array_equal(back.stamps, trajectory.stamps)
        np.testing.assert_array_equal(back.poses[:, :2], trajectory.poses[:, :2])
    assert resolve_config(file=tmp_path / "config.toml") == estimate.config
    assert json.loads((tmp_path / "metrics.json").read_text()) == figures
    assert figures["scans"] == len(estimate.trajectory)
    about = json.loads((tmp_path / "run.json").read_text())
    assert (about["seed"], about["threads"]) == (1, 2)
    assert not list(tmp_path.glob("*figure*"))
    assert {file.suffix for file in tmp_path.iterdir()} == {
        *(".tum", ".png", ".pgm", ".yaml", ".json", ".toml", ".csv", ".npz", ".g2o", "")
    }
    log_odds = read_map_arrays(tmp_path / "map.npz")
    assert log_odds.values.tobytes() == estimate.map.values.tobytes()
    assert (log_odds.cell_size, log_odds.origin) == (estimate.map.cell_size, estimate.map.origin)
    graph = read_g2o(tmp_path / "graph.g2o")
    np.testing.assert_array_equal(graph.poses, estimate.graph.poses)
    np.testing.assert_array_equal(graph.information, estimate.graph.information)
    np.testing.assert_array_equal(graph.loops, estimate.graph.loops)
    read = read_result_folder(tmp_path)
    assert read.known["final.ate"] == number(figures, "final.ate")
    assert read.scores["final.ate"]["unit"] == "m"
    assert read.scores["map_f1"] == {"absent": "no true map"}
    assert (read.run.scenario, read.run.seed) == (estimate.name, 1)


def test_without_truth_what_needs_it_is_absent(run, tmp_path: Path) -> None:
    figures = write_results(tmp_path, run[0], figures=False)
    assert figures["metrics"]["final.ate"] == {"absent": "no truth"}
    assert number(figures, "effective_particles") > 1
    assert figures["localisation"]["compared"] is None
    assert not (tmp_path / "truth.tum").exists()


def test_the_results_of_another_run_are_removed_and_nothing_else(run, simulation, tmp_path: Path) -> None:
    (tmp_path / "truth.tum").touch()
    with result_folder(tmp_path / "drive") as work:
        (work / "drive.log").touch()
    for folder in (tmp_path, tmp_path / "drive"):
        write_results(folder, run[0], simulation.truth, figures=folder == tmp_path)
        before = {path.name for path in folder.iterdir()}
        write_results(folder, replace(run[0], loops=()), figures=False)
        gone = before - {path.name for path in folder.iterdir()}
        pictures = ("trajectories", "dead_reckoning", "particles", "effective_particles", "error")
        assert gone == ({f"{name}.png" for name in pictures} if folder == tmp_path else {"truth.tum"})
    assert (tmp_path / "drive" / "drive.log").exists()


def test_a_truth_on_another_clock_writes_nothing(run, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no stamps in common"):
        write_results(tmp_path, run[0], Trajectory(np.arange(3.0), np.zeros((3, 3))))
    assert not list(tmp_path.iterdir())


def test_each_figure_stands_in_one_place_and_is_of_its_trajectory(run, simulation) -> None:
    estimate, _ = run
    true = simulation.truth.at(estimate.trajectory.stamps)
    rng = np.random.default_rng(0)

    def astray(deviation: float) -> Trajectory:
        return Trajectory(true.stamps, true.poses + deviation * rng.normal(size=(len(true), 3)) * (1.0, 1.0, 0.1))

    apart = replace(estimate, trajectory=astray(0.2), trajectory_final=astray(0.05), dead_reckoning=astray(0.8))
    figures = score_estimate(apart, simulation.truth)
    errors = [number(figures, f"{name}.ate") for name in ("online", "final", "dead_reckoning")]
    assert errors == pytest.approx(np.sqrt(2) * np.array([0.2, 0.05, 0.8]), rel=0.1)
    ate = evidence_of(apart, simulation.truth).track("final").ate.translation.as_dict()
    found = figures["metrics"]["final.ate"] | {"rmse": errors[1], "max": number(figures, "final.ate_max")}
    assert all(found[name] == ate[name] for name in ("rmse", "mean", "std", "min", "max", "count"))
    values = [value for value in _leaves(figures) if isinstance(value, float) and not value.is_integer()]
    assert len(values) == len(set(values))


def _leaves(value: object) -> list[object]:
    if isinstance(value, dict):
        return [leaf for below in value.values() for leaf in _leaves(below)]
    return [leaf for below in value for leaf in _leaves(below)] if isinstance(value, list) else [value]


LOOPS = (
    candidate(3, 170, stamps=(1543234.3, 1543251.0), found=(0.1, -1 / 3, 3.1), predicted=(0.4, -1e-9, -3.1)),
    candidate(4, 171, verdict="weak"),
    candidate(4, 180, verdict="contradicted"),
    candidate(9, 181, verdict="weak"),
)
DIAGNOSTICS_ROW = "1.5,sure,1,1,1,1,1,1,nan,0.1,30,20,0.9,1,0,0"


@pytest.fixture
def lost(run) -> Estimate:
    """A run that was lost at two scans, doubtful at one, with a degenerate direction at another."""
    estimate = run[0]
    diagnostics = {name: values.copy() for name, values in estimate.diagnostics.items()}
    diagnostics["state"][:] = LocalisationState.SURE
    diagnostics["state"][[3, 5, 6]] = LocalisationState.DOUBTFUL, LocalisationState.LOST, LocalisationState.LOST
    diagnostics["degenerate"][:] = np.nan
    diagnostics["degenerate"][2] = -0.1
    return replace(estimate, diagnostics=diagnostics)


def test_diagnostics_read_back_bit_for_bit(lost: Estimate, tmp_path: Path):
    write_diagnostics(tmp_path / "diagnostics.csv", lost)
    header, *rows = (tmp_path / "diagnostics.csv").read_text().splitlines()
    assert header.split(",") == list(DIAGNOSTICS_COLUMNS)
    assert [row.split(",")[1] for row in rows[:7]] == ["sure", "sure", "sure", "doubtful", "sure", "lost", "lost"]
    back = read_diagnostics(tmp_path / "diagnostics.csv")
    np.testing.assert_array_equal(back.stamps, lost.trajectory.stamps)
    np.testing.assert_array_equal(back.covariances, lost.covariances)
    for name in ("state", *VALUES):
        np.testing.assert_array_equal(back.values[name], lost.diagnostics[name], err_msg=name)
    assert set(lost.diagnostics) == {*back.values, "seconds"}  # which differ from run to run


def test_loops_read_back_bit_for_bit(tmp_path: Path) -> None:
    write_loops(tmp_path / "loops.csv", LOOPS)
    header, *rows = (tmp_path / "loops.csv").read_text().splitlines()
    assert header.split(",") == list(LOOP_COLUMNS)
    assert rows[0].startswith("3,170,1543234.3,1543251.0,0.4,-1e-09,-3.1,0.1,-0.3333333333333333,3.1,3.5,0.3490658503")
    assert rows[0].endswith(",0.9,0.3333333333333333,0.95,0.8,0.01,accepted")
    back = read_loops(tmp_path / "loops.csv")
    assert [loop.verdict for loop in back] == [loop.verdict for loop in LOOPS]
    np.testing.assert_array_equal(back[0].found, LOOPS[0].found)
    write_loops(tmp_path / "again.csv", back)
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "loops.csv").read_bytes()


READERS = {"loops.csv": read_loops, "diagnostics.csv": read_diagnostics}


@pytest.mark.parametrize(
    ("name", "old", "new", "line", "field"),
    [
        ("loops.csv", None, "", 1, None),
        ("loops.csv", ",weak", "", 3, None),
        ("loops.csv", "weak", "lost", 3, "verdict"),
        ("loops.csv", "\n4,", "\n4.5,", 3, "earlier"),
        ("loops.csv", "0.95", "nan", 2, "known"),
        ("loops.csv", "1543234.3", "soon", 2, "earlier_stamp"),
        ("loops.csv", "\n9,", "\n182,", 5, "later"),
        ("diagnostics.csv", "nan", "inf", 2, "degenerate"),
        ("diagnostics.csv", "sure", "happy", 2, "state"),
        ("diagnostics.csv", "1.5", "nan", 2, "stamp"),
        ("metrics.json", None, "[", None, None),
        ("metrics.json", None, '{"metrics": {"ate": 1}}', None, "metrics.ate"),
    ],
)
def test_a_broken_file_is_refused_with_its_place(
    tmp_path: Path, name: str, old: str | None, new: str, line: int | None, field: str | None
):
    (tmp_path / "run.json").write_text("{}")
    write_loops(tmp_path / "loops.csv", LOOPS)
    (tmp_path / "diagnostics.csv").write_text(f"{','.join(DIAGNOSTICS_COLUMNS)}\n{DIAGNOSTICS_ROW}\n")
    (tmp_path / name).write_text(new if old is None else (tmp_path / name).read_text().replace(old, new, 1))
    with refusal(InputError, file=tmp_path / name, line=line, field=field):
        READERS[name](tmp_path / name) if name in READERS else read_result_folder(tmp_path)


def test_states_in_the_figures_and_in_a_line(lost: Estimate, run, simulation, tmp_path: Path):
    figures = write_results(tmp_path, lost, simulation.truth, figures=False)
    found = json.loads((tmp_path / "metrics.json").read_text())["localisation"]
    assert found["states"] == {"sure": len(lost.trajectory) - 3, "doubtful": 1, "lost": 2}
    assert found["first_lost_stamp"] == lost.trajectory.stamps[5]
    assert found["compared"]["wrong"] == 0
    assert figures["metrics"]["lost_precision"]["value"] == 0
    said = [list(run_lines({"out": "x", **described(one, score_estimate(one))}, "room")) for one in (lost, run[0])]
    assert [any("lost at 2" in line for line in lines) for lines in said] == [True, False]


def test_a_run_that_looks_for_loops_has_its_ledger(run, simulation, tmp_path: Path) -> None:
    config = run[0].config.model_copy(update={"backend": BackendConfig(method="looks")})
    estimate = replace(run[0], config=config, loops=LOOPS)
    figures = write_results(tmp_path, estimate, simulation.truth, recording=simulation.recording, figures=False)
    assert len(read_loops(tmp_path / "loops.csv")) == len(LOOPS)
    counts = json.loads((tmp_path / "run.json").read_text())["loops"]
    assert counts == {"candidates": 4, "accepted": 1, **dict.fromkeys(VERDICTS[1:], 0), "weak": 2, "contradicted": 1}
    assert json.loads((tmp_path / "metrics.json").read_text()) == figures
    assert figures["metrics"]["loops_precision"] == {
        "absent": "no precision of the loops: the truth covers no accepted loop"
    }
    assert figures["metrics"]["loops_recall"] == {"absent": "no recall of the loops: no key scan has a possible loop"}
    config = estimate.config.model_copy(update={"backend": NoBackendConfig()})
    assert "loop" not in "".join(
        score_lines(score_estimate(replace(estimate, config=config, loops=()), simulation.truth))
    )


def test_the_bag_holds_map_paths_and_scans_and_its_transforms_lead_along_the_final_path(
    simulation, run, tmp_path: Path
) -> None:
    estimate, _ = run
    file = tmp_path / "result.mcap"
    write_result_bag(file, estimate, simulation.recording)
    last: dict[str, object] = {}
    moved: dict[str, dict[float, np.ndarray]] = {"map": {}, "odom": {}}
    with AnyReader([file]) as reader:
        for connection, time, data in reader.messages():
            last[connection.topic] = message = reader.deserialize(data, connection.msgtype)
            if connection.topic == "/tf":
                (one,) = message.transforms
                place, turn = one.transform.translation, one.transform.rotation
                pose = np.array((place.x, place.y, 2 * np.arctan2(turn.z, turn.w)))
                moved[one.header.frame_id][time / 1e9] = pose
    grid = last["/map"]
    assert (grid.info.height, grid.info.width) == estimate.map.shape
    cells = grid.data.reshape(estimate.map.shape)
    np.testing.assert_array_equal(cells == 100, trinary(estimate.map.values) == 1)
    assert set(np.unique(cells)) == {-1, 0, 100}
    final = estimate.trajectory_final
    for name, path in (("final", final), ("online", estimate.trajectory), ("dead_reckoning", estimate.dead_reckoning)):
        found = [(each.pose.position.x, each.pose.position.y) for each in last[f"/path/{name}"].poses]
        np.testing.assert_allclose(found, path.poses[:, :2])
    assert last["/loops"].ns == ""
    stamps = np.array(sorted(moved["odom"]))
    odometry = se2.interpolate(stamps, np.array([moved["odom"][each] for each in stamps]), final.stamps)
    corrections = np.array([moved["map"][each] for each in sorted(moved["map"])])
    np.testing.assert_allclose(se2.compose(corrections, odometry)[:, :2], final.poses[:, :2], atol=1e-5)
    back = open_recording(file)
    assert back.lidar.ranges[:].tobytes() == simulation.recording.lidar.ranges[:].tobytes()


def test_replay_writes_it_where_it_is_asked_for(simulated_folder: Path, tmp_path: Path) -> None:
    out = tmp_path / "out"
    options = ["--preset", "paper", "--set", "particles=3", "--no-figures", "--end", "3", "--mcap"]
    assert main.run(["replay", str(simulated_folder), "--out", str(out), *options]) == 0
    assert "result.mcap" in (out / ".moteslam").read_text()
    assert main.run(["replay", str(simulated_folder), "--out", str(out), "--force", *options[:-1]]) == 0
    assert not (out / "result.mcap").exists()


def test_an_estimate_is_shown_as_its_map_and_path(run) -> None:
    estimate, _ = run
    image = cv2.imdecode(np.frombuffer(estimate._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    assert max(image.shape) <= 800
    slam = (abs(image.astype(int) - (0xB2, 0x72, 0x00)) < 20).all(axis=2)
    assert slam.any()


Arrays = dict[str, np.ndarray[Any, Any]]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A drive, and the result of its beginning."""
    folder = tmp_path_factory.mktemp("sessions")
    write_simulation(folder / "log", simulate(scenario_of("office", 310, duration=40.0), 310))
    words = ["replay", str(folder / "log"), "--end", "25", "--out", str(folder / "result"), "--no-figures"]
    assert main.run([*words, "--set", "particles=5"]) == 0
    return folder


def contents(folder: Path) -> dict[str, bytes]:
    return {file.name: file.read_bytes() for file in folder.iterdir()}


@pytest.mark.slow
def test_a_result_is_gone_on_with_and_stays_as_it_is(folder: Path, capsys: Capsys) -> None:
    before = contents(folder / "result")
    few = ("--no-figures", "--set", "particles=5")
    onto = ("--onto", folder / "result", *few)
    printed(capsys, "replay", folder / "log", "--start", 15, *onto, "--out", folder / "both")
    assert contents(folder / "result") == before
    building = read_building(folder / "both")
    assert len(building.sessions) == 2
    assert building.between.any()
    for count, session in enumerate(building.sessions, start=1):
        written = read_tum(folder / "both" / f"session_{count}.tum")
        np.testing.assert_allclose(written.poses, session.path, atol=1e-5)
    final = read_tum(folder / "both" / "trajectory_final.tum")
    np.testing.assert_allclose(final.poses, building.sessions[1].path, atol=1e-5)
    # what was bound is a result to go on with, too
    printed(capsys, "replay", folder / "log", "--onto", folder / "both", *few, "--out", folder / "three")
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
        (without("steps"), "steps"),
        (put("path", lambda path: path * np.nan), "path"),
        (put("nodes", lambda nodes: nodes[::-1]), "nodes"),
        (put("sizes", lambda sizes: sizes + 1), "sizes"),
        (put("counts", lambda counts: counts + 1), "counts"),
        (put("covariance", lambda covariance: -covariance), "covariance"),
        (put("prior_steps", lambda steps: steps[1:]), "prior_steps"),
        (put("first", lambda _: np.array([5])), "second"),
    ],
)
def test_a_broken_file_is_refused(folder: Path, tmp_path: Path, change: Callable[[Arrays], Arrays], field: str) -> None:
    with np.load(folder / "result" / NAME) as stored:
        arrays = change(dict(stored))
    np.savez_compressed(tmp_path / NAME, **arrays)
    with refusal(InputError, field=field, file=tmp_path / NAME):
        read_building(tmp_path)


@pytest.mark.parametrize("what", ["missing", "back end"])
def test_what_cannot_be_gone_on_with_is_one_line(folder: Path, tmp_path: Path, capsys: Capsys, what: str) -> None:
    old, more = tmp_path / "old", []
    old.mkdir()
    if what == "back end":
        old, more = folder / "result", ["--set", "backend.method=none"]
    line = refused(capsys, "replay", folder / "log", "--onto", old, "--out", tmp_path / "out", *more)
    assert ("--onto" if what == "back end" else f"{old}: no {NAME}") in line
    assert not (tmp_path / "out").exists()


def test_stamps_that_ros_does_not_hold_are_refused(simulation, run, tmp_path: Path) -> None:
    estimate = run[0]
    early = Trajectory(estimate.trajectory.stamps - 2e9, estimate.trajectory.poses)
    with pytest.raises(InputError, match="expected 0 to"):
        write_result_bag(tmp_path / "result.mcap", replace(estimate, trajectory=early), simulation.recording)
    assert not list(tmp_path.iterdir())
