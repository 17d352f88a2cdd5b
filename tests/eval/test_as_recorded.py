"""Noise as recorded: the scans of a simulated LMS200 lie as far from each other as those of real logs."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from parts.runs import HALF_DEGREE, LOGS

from moteslam.eval.metrics.residuals import ResidualResult, scan_residuals
from moteslam.robot.formats import open_recording
from moteslam.robot.recording import Recording
from moteslam.sim.scenario import load_scenario
from moteslam.sim.simulate import simulate
from moteslam.slam.config import resolve_config
from moteslam.slam.online import run_slam

FACTOR = 1.3
TAIL = 1.4
"""For the share beyond 3 cm: logs of one and of half a degree differ by 1.7 in it beyond what the angle explains, and
the simulation lies between them; no one class is within 1.3 of both with room for chance."""
OFFICE_FLOORS = ("corridor", "office", "loop")
"""Buildings like those of the logs: corridors and offices."""
HALF = {"csail": (0.0090, 0.0306, 0.103, 0.0281), "freiburg-101": (0.0089, 0.0285, 0.0913, None)}
ONE = {"intel_key_scans": (0.0081, 0.0258, 0.0773, 0.0255)}  # means of SLAM seeds 0 to 4
"""Median and 90 % quantile [m], shares beyond 3 cm and without return, of the logs of beams half a degree and a degree
apart (docs/results.md). The halls of freiburg-101 give 11.9 % without return, which follows from the building."""
REAL = HALF | ONE

pytestmark = [pytest.mark.slow, pytest.mark.usefixtures("taichi")]


def figures(found: ResidualResult) -> tuple[float, float, float, float]:
    return found.median, found.quantile_90, found.beyond_3_cm, found.no_return


def under_slam(recording: Recording) -> ResidualResult:
    """Under the filter's poses: the joint registration of the back end minimises what is measured here."""
    alone = resolve_config(settings=["backend.method=none", "particles=8"])
    return scan_residuals(recording, run_slam(recording, alone, seed=0).trajectory_final)


def simulated(noise: str, settings: Sequence[str] = ()) -> np.ndarray:
    """The figures [4], the median over buildings: what is drawn once a recording differs between them."""
    scenarios = [load_scenario(name, platform="lms200", noise=noise, settings=settings) for name in OFFICE_FLOORS]
    rows = [figures(under_slam(simulate(scenario, 7).recording)) for scenario in scenarios]
    return np.asarray(np.median(rows, axis=0))


@pytest.mark.parametrize(("settings", "logs"), [((), ONE), (HALF_DEGREE, HALF)])
def test_as_recorded_is_as_hard_as_real_logs(
    settings: Sequence[str], logs: dict[str, tuple[float | None, ...]]
) -> None:
    median = simulated("as_recorded", settings)
    for log, real in logs.items():
        for found, measured, factor in zip(median, real, (FACTOR, FACTOR, TAIL, FACTOR), strict=True):
            if measured is not None:
                assert measured / factor < found < measured * factor, (log, found, measured)


def test_the_data_sheet_is_easier_than_any_log() -> None:
    easier = simulated("datasheet")
    assert (easier < np.array(REAL["intel_key_scans"]) / FACTOR).all()


@pytest.mark.parametrize("log", REAL)
def test_the_figures_of_the_real_logs_are_measured(log: str, data_folder: Path) -> None:
    found = figures(under_slam(open_recording(data_folder / f"{LOGS[log]}.log.gz")))
    for value, stated in zip(found, REAL[log], strict=True):
        if stated is not None:
            assert value == pytest.approx(stated, rel=0.05)
