"""``diagnostics.csv``: written, read back, refused; and what is made of it in JSON and on the command line."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.cli.running import Run, say_run
from moteslam.eval.diagnostics_table import (
    COLUMNS,
    VALUES,
    read_diagnostics,
    write_diagnostics,
)
from moteslam.eval.results import write_results
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState


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


def test_what_is_written_reads_back(lost: Estimate, tmp_path: Path):
    write_diagnostics(tmp_path / "diagnostics.csv", lost)
    header, *rows = (tmp_path / "diagnostics.csv").read_text().splitlines()
    assert header.split(",") == list(COLUMNS)
    assert [row.split(",")[1] for row in rows[:7]] == ["sure", "sure", "sure", "doubtful", "sure", "lost", "lost"]
    back = read_diagnostics(tmp_path / "diagnostics.csv")
    np.testing.assert_array_equal(back.stamps, lost.trajectory.stamps)
    np.testing.assert_array_equal(back.covariances, lost.covariances)
    for name in ("state", *VALUES):
        np.testing.assert_array_equal(back.values[name], lost.diagnostics[name], err_msg=name)
    assert set(lost.diagnostics) == {*back.values, "seconds"}  # which differ from run to run


def test_the_result_folder_sums_it_up(lost: Estimate, simulation, tmp_path: Path):
    scores = write_results(tmp_path, lost, simulation.truth, figures=False)
    stamp = lost.trajectory.stamps[5]
    expected = {
        "states": {"sure": len(lost.trajectory) - 3, "doubtful": 1, "lost": 2},
        "first_lost_stamp": stamp,
    }
    metrics = json.loads((tmp_path / "metrics.json").read_text())
    assert metrics["localisation"] == json.loads((tmp_path / "run.json").read_text())["localisation"] == expected
    assert scores is not None
    assert scores.localisation is not None
    assert metrics["scores"]["localisation"] == scores.localisation.as_dict()
    assert scores.localisation.precision(LocalisationState.LOST) == 0
    assert len(read_diagnostics(tmp_path / "diagnostics.csv").stamps) == len(lost.trajectory)


def test_a_line_says_where_the_robot_was_lost(lost: Estimate, run, tmp_path: Path, capsys):
    seconds = lost.trajectory.stamps[5] - lost.trajectory.stamps[0]
    say_run(Run(lost, None, ()), tmp_path, "room", as_json=False)
    assert f"lost at 2 scans, first after {seconds:.1f} s: see diagnostics.csv" in capsys.readouterr().out
    say_run(Run(run[0], None, ()), tmp_path, "room", as_json=False)
    assert "lost" not in capsys.readouterr().out


ROW = "1.5,sure,1,1,1,1,1,1,nan,0.1,30,20,0.9,1,0,0"


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("a,b\n", f":1: expected the columns {','.join(COLUMNS)}"),
        ("HEADER\n1,sure\n", ":2: 2 columns, expected 16"),
        (
            f"HEADER\n{ROW}\n{ROW.replace('sure', 'happy')}\n",
            ":3: state: 'happy', expected one of sure, doubtful, lost",
        ),
        (f"HEADER\n{ROW.replace('1.5', 'noon')}\n", ":2: expected numbers in all columns but the state"),
        (f"HEADER\n{ROW.replace('1.5', 'nan')}\n", ":2: expected finite numbers, nan for degenerate alone"),
    ],
)
def test_a_broken_table_is_refused_in_one_line(tmp_path: Path, text: str, problem: str):
    file = tmp_path / "diagnostics.csv"
    file.write_text(text.replace("HEADER", ",".join(COLUMNS)))
    with pytest.raises(InputError) as error:
        read_diagnostics(file)
    assert str(error.value) == f"{file}{problem}"
