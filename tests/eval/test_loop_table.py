"""``loops.csv`` and what ``run.json`` sums up of it: in the folder of a run whose back end looks for loops, alone."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from loop_candidates import candidate

from moteslam.errors import InputError
from moteslam.eval.cli.running import score_table
from moteslam.eval.loop_table import COLUMNS, VERDICTS, read_loops, write_loops
from moteslam.eval.results import write_results
from moteslam.eval.scores import score_estimate
from moteslam.robot.files import result_folder
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.none import NoBackendConfig
from moteslam.slam.backend.protocol import BackendConfig
from moteslam.slam.estimate import Estimate

LOOPS = (
    candidate(3, 170, stamps=(1543234.3, 1543251.0), found=(0.1, -1 / 3, 3.1), predicted=(0.4, -1e-9, -3.1)),
    candidate(4, 171, verdict="weak"),
    candidate(4, 180, verdict="contradicted"),
    candidate(9, 181, verdict="weak"),
)


def looking(estimate: Estimate, loops: tuple[LoopCandidate, ...] = LOOPS) -> Estimate:
    """A run as a back end leaves it that looked for loops."""
    config = estimate.config.model_copy(update={"backend": BackendConfig(method="looks")})
    return replace(estimate, config=config, loops=loops)


def alone(estimate: Estimate) -> Estimate:
    """The same without a back end."""
    config = estimate.config.model_copy(update={"backend": NoBackendConfig()})
    return replace(estimate, config=config, loops=())


def test_what_is_written_reads_back_bit_for_bit(tmp_path: Path) -> None:
    write_loops(tmp_path / "loops.csv", LOOPS)
    header, *rows = (tmp_path / "loops.csv").read_text().splitlines()
    assert header.split(",") == list(COLUMNS)
    assert rows[0].startswith("3,170,1543234.3,1543251.0,0.4,-1e-09,-3.1,0.1,-0.3333333333333333,3.1,3.5,0.3490658503")
    assert rows[0].endswith(",0.9,0.3333333333333333,0.95,0.8,0.01,accepted")
    back = read_loops(tmp_path / "loops.csv")
    for one, other in zip(LOOPS, back, strict=True):
        assert (one.earlier, one.later, one.stamps, one.window) == (
            *(other.earlier, other.later),
            *(other.stamps, other.window),
        )
        np.testing.assert_array_equal([one.predicted, one.found], [other.predicted, other.found])
        assert (one.share, one.runner_up, one.known, one.likelihood, one.crossed, one.verdict) == (
            *(other.share, other.runner_up, other.known, other.likelihood, other.crossed, other.verdict),
        )
    write_loops(tmp_path / "again.csv", back)
    assert (tmp_path / "again.csv").read_bytes() == (tmp_path / "loops.csv").read_bytes()


@pytest.mark.parametrize(
    ("change", "problem"),
    [
        (lambda text: "", "1: expected the columns earlier,later,"),
        (lambda text: text.replace("share,", ""), "1: expected the columns"),
        (lambda text: text.replace(",weak", "", 1), "3: 17 columns, expected 18"),
        (lambda text: text.replace("weak", "lost", 1), "3: verdict: 'lost', expected one of accepted, weak"),
        (lambda text: text.replace("\n4,", "\n4.5,", 1), "3: earlier: '4.5', expected the index of a scan"),
        (lambda text: text.replace("\n4,171", "\n4,-171", 1), "3: later: '-171', expected the index of a scan"),
        (lambda text: text.replace("\n4,", f"\n{9 * '9999'},", 1), f"3: earlier: '{9 * '9999'}', expected the index"),
        (lambda text: text.replace("0.95", "nan", 1), "2: known: 'nan', expected a finite number"),
        (lambda text: text.replace("0.95", "", 1), "2: known: '', expected a finite number"),
        (lambda text: text.replace("1543234.3", "soon", 1), "2: earlier_stamp: 'soon', expected a finite number"),
        (lambda text: text.replace("\n9,", "\n182,"), "5: later: 181, expected more than that of earlier, 182"),
    ],
)
def test_a_broken_table_is_refused_with_its_line(tmp_path: Path, change, problem: str) -> None:
    file = tmp_path / "loops.csv"
    write_loops(file, LOOPS)
    file.write_text(change(file.read_text()))
    with pytest.raises(InputError) as caught:
        read_loops(file)
    assert str(caught.value).startswith(f"{file}:{problem}")


def test_a_run_that_looks_for_loops_has_its_ledger(run, simulation, tmp_path: Path) -> None:
    estimate = looking(run[0])
    scores = write_results(tmp_path, estimate, simulation.truth, recording=simulation.recording, figures=False)
    assert len(read_loops(tmp_path / "loops.csv")) == len(LOOPS)
    about = json.loads((tmp_path / "run.json").read_text())
    assert about["loops"] == {
        "candidates": 4,
        "accepted": 1,
        **dict.fromkeys(VERDICTS[1:], 0),
        "weak": 2,
        "contradicted": 1,
    }
    assert list(about["loops"])[:2] == ["candidates", "accepted"]
    assert scores is not None
    assert scores.loops is not None
    assert json.loads((tmp_path / "metrics.json").read_text())["scores"]["loops"] == scores.loops.as_dict()
    assert score_table(scores).splitlines()[-2:] == [
        "no precision of the loops: the truth covers no accepted loop",
        "no recall of the loops: no key scan has a possible loop",
    ]


def test_what_replay_prints_of_a_run_without_back_end_has_no_loops(run, simulation) -> None:
    assert "loop" not in score_table(score_estimate(alone(run[0]), simulation.truth, recording=simulation.recording))


def test_without_a_candidate_there_is_the_header_alone_and_no_figure(run, tmp_path: Path) -> None:
    write_results(tmp_path, looking(run[0], ()))
    assert (tmp_path / "loops.csv").read_text() == ",".join(COLUMNS) + "\n"
    assert not (tmp_path / "loops.png").exists()
    assert (tmp_path / "trajectories.png").exists()
    assert json.loads((tmp_path / "run.json").read_text())["loops"]["candidates"] == 0


def test_a_folder_replaced_by_a_run_without_back_end_keeps_no_ledger(run, simulation, tmp_path: Path) -> None:
    for estimate in (looking(run[0]), alone(run[0])):
        with result_folder(tmp_path / "result", force=True) as folder:
            write_results(folder, estimate, simulation.truth)
            assert (folder / "loops.csv").exists() == (folder / "loops.png").exists() == bool(estimate.loops)
    assert not list((tmp_path / "result").glob("loops*"))
    assert "loops" not in (tmp_path / "result" / ".moteslam").read_text()
    assert "loops" not in json.loads((tmp_path / "result" / "run.json").read_text())
    assert "loops" not in json.loads((tmp_path / "result" / "metrics.json").read_text())["scores"]
