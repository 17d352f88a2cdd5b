"""``diagnostics.csv`` and ``loops.csv``: written, read back bit for bit, refused; and what is printed of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_candidates import candidate

from moteslam.errors import InputError
from moteslam.eval.cli.running import described, run_lines, score_lines
from moteslam.eval.results import write_results
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
from moteslam.eval.scores import score_estimate
from moteslam.slam.backend.kinds import NoBackendConfig
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.protocol import BackendConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState

LOOPS = (
    candidate(3, 170, stamps=(1543234.3, 1543251.0), found=(0.1, -1 / 3, 3.1), predicted=(0.4, -1e-9, -3.1)),
    candidate(4, 171, verdict="weak"),
    candidate(4, 180, verdict="contradicted"),
    candidate(9, 181, verdict="weak"),
)
DIAGNOSTICS_ROW = "1.5,sure,1,1,1,1,1,1,nan,0.1,30,20,0.9,1,0,0"


def looking(estimate: Estimate, loops: tuple[LoopCandidate, ...] = LOOPS) -> Estimate:
    """A run as a back end leaves it that looked for loops."""
    config = estimate.config.model_copy(update={"backend": BackendConfig(method="looks")})
    return replace(estimate, config=config, loops=loops)


def alone(estimate: Estimate) -> Estimate:
    """The same without a back end."""
    config = estimate.config.model_copy(update={"backend": NoBackendConfig()})
    return replace(estimate, config=config, loops=())


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


@pytest.mark.parametrize(
    ("change", "line", "field"),
    [
        (lambda text: "", 1, None),
        (lambda text: text.replace(",weak", "", 1), 3, None),
        (lambda text: text.replace("weak", "lost", 1), 3, "verdict"),
        (lambda text: text.replace("\n4,", "\n4.5,", 1), 3, "earlier"),
        (lambda text: text.replace("\n4,", f"\n{9 * '9999'},", 1), 3, "earlier"),
        (lambda text: text.replace("0.95", "nan", 1), 2, "known"),
        (lambda text: text.replace("1543234.3", "soon", 1), 2, "earlier_stamp"),
        (lambda text: text.replace("\n9,", "\n182,"), 5, "later"),
    ],
)
def test_a_broken_table_of_loops_is_refused_with_its_line(tmp_path: Path, change, line: int, field: str | None):
    file = tmp_path / "loops.csv"
    write_loops(file, LOOPS)
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError) as caught:
        read_loops(file)
    assert (caught.value.file, caught.value.line, caught.value.field) == (str(file), line, field)


@pytest.mark.parametrize(
    ("change", "line", "field"),
    [
        (("nan", "inf"), 2, "degenerate"),
        (("sure", "happy"), 2, "state"),
        (("1.5", "nan"), 2, "stamp"),
    ],
)
def test_a_broken_table_of_diagnostics_is_refused_with_its_line(tmp_path: Path, change, line: int, field: str):
    file = tmp_path / "diagnostics.csv"
    file.write_text(f"{','.join(DIAGNOSTICS_COLUMNS)}\n{DIAGNOSTICS_ROW.replace(*change)}\n")
    with pytest.raises(InputError) as caught:
        read_diagnostics(file)
    assert (caught.value.file, caught.value.line, caught.value.field) == (str(file), line, field)


def test_states_in_the_figures_and_in_a_line(lost: Estimate, run, simulation, tmp_path: Path):
    figures = write_results(tmp_path, lost, simulation.truth, figures=False)
    found = json.loads((tmp_path / "metrics.json").read_text())["localisation"]
    assert found["states"] == {"sure": len(lost.trajectory) - 3, "doubtful": 1, "lost": 2}
    assert found["first_lost_stamp"] == lost.trajectory.stamps[5]
    assert found["compared"]["wrong"] == 0
    assert figures["metrics"]["lost_precision"]["value"] == 0
    seconds = lost.trajectory.stamps[5] - lost.trajectory.stamps[0]
    lines = list(run_lines({"out": "x", **described(lost, figures)}, "room"))
    assert lines[1] == (
        f"doubtful at 1, lost at 2 of {len(lost.trajectory)} scans, first after {seconds:.1f} s: diagnostics.csv"
    )
    found = {"out": "x", **described(run[0], score_estimate(run[0]))}
    assert not any("lost" in line for line in run_lines(found, "room"))


def test_a_run_that_looks_for_loops_has_its_ledger(run, simulation, tmp_path: Path) -> None:
    estimate = looking(run[0])
    figures = write_results(tmp_path, estimate, simulation.truth, recording=simulation.recording, figures=False)
    assert len(read_loops(tmp_path / "loops.csv")) == len(LOOPS)
    counts = json.loads((tmp_path / "run.json").read_text())["loops"]
    assert counts == {"candidates": 4, "accepted": 1, **dict.fromkeys(VERDICTS[1:], 0), "weak": 2, "contradicted": 1}
    assert json.loads((tmp_path / "metrics.json").read_text()) == figures
    assert figures["metrics"]["loops_precision"] == {
        "absent": "no precision of the loops: the truth covers no accepted loop"
    }
    assert figures["metrics"]["loops_recall"] == {"absent": "no recall of the loops: no key scan has a possible loop"}
    assert "loop" not in "".join(score_lines(score_estimate(alone(run[0]), simulation.truth)))


def test_without_a_candidate_there_is_the_header_alone_and_no_figure(run, tmp_path: Path) -> None:
    write_results(tmp_path, looking(run[0], ()))
    assert (tmp_path / "loops.csv").read_text() == ",".join(LOOP_COLUMNS) + "\n"
    assert not (tmp_path / "loops.png").exists()
    assert (tmp_path / "trajectories.png").exists()
