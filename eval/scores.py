"""The figures of a run: one dict, which ``metrics.json``, ``--json`` and what is printed have in common."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import match
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE, Certainty, Evidence
from moteslam.eval.metrics.localisation import state_counts
from moteslam.eval.metrics.registry import measure
from moteslam.robot.formats.map_server import read_map, trinary
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.filter.certainty import LocalisationState

Figures = dict[str, Any]
"""Of a run, fit for JSON: what ``metrics.json`` holds (``docs/reference/formats.md``)."""


def evidence_of(
    estimate: Estimate,
    truth: Trajectory | None = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
) -> Evidence:
    """What is known of a run of ours when it is scored; arguments as of ``score_estimate``."""
    diagnostics, occupancy = estimate.diagnostics, estimate.map
    return Evidence(
        trajectories={
            FINAL: estimate.trajectory_final,
            ONLINE: estimate.trajectory,
            DEAD_RECKONING: estimate.dead_reckoning,
        },
        truth=truth,
        occupancy=Raster(trinary(occupancy.values), occupancy.cell_size, occupancy.origin),
        true_map=true_map,
        recording=recording,
        certainty=Certainty(
            estimate.covariances,
            diagnostics["state"],
            diagnostics["updated"],
            diagnostics["n_eff"],
            estimate.particle_spread,
            estimate.corrections,
        ),
        loops=estimate.loops if looks_for_loops(estimate.config) else None,
    )


def looks_for_loops(config: SlamConfig) -> bool:
    """Whether the back end of a run looks for loops: any but ``none``, unless they are switched off."""
    loops = getattr(config.backend, "loops", None)
    return config.backend.method != "none" and getattr(loops, "enabled", True)


def score_estimate(
    estimate: Estimate,
    truth: Trajectory | None = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
) -> Figures:
    """Score a run.

    Args:
        estimate: the run.
        truth: on the clock of its recording.
        recording: its scans show which loops are possible, and which walls were seen.
        true_map: trinary, in the frame of the truth; without it the map is not scored.

    Raises:
        InputError: the truth has no stamps in common with the run.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    return figures_of(estimate, evidence_of(estimate, truth, recording=recording, true_map=true_map))


def figures_of(estimate: Estimate, run: Evidence) -> Figures:
    """The same of a run whose evidence is at hand."""
    stamps, diagnostics = estimate.trajectory.stamps, estimate.diagnostics
    if run.truth is not None:
        match(estimate.trajectory, run.truth)  # a truth on another clock is an error, not an absent figure
    lost = np.flatnonzero(diagnostics["state"] == LocalisationState.LOST)
    figures: Figures = {
        "scans": len(stamps),
        "duration_s": float(stamps[-1] - stamps[0]),
        "distance_m": estimate.trajectory_final.length,
        "updates": int(diagnostics["updated"].sum()),
        "resampled": int(diagnostics["resampled"].sum()),
        "mean_particles": float(diagnostics["particles"].mean()),
        "localisation": {
            "states": state_counts(diagnostics["state"]),
            "first_lost_stamp": float(stamps[lost[0]]) if len(lost) else None,
            "compared": _compared_states(run),
        },
    }
    if run.loops is not None and run.truth is not None and run.truth.oriented:
        found = run.loop_result.as_dict()
        metrics = ("precision", "recall", "false")
        figures["loops"] = {name: value for name, value in found.items() if name not in metrics}
    figures["metrics"] = {name: value.as_dict() for name, value in measure(run).items()}
    return figures


def _compared_states(run: Evidence) -> dict[str, Any] | None:
    """The states of the scans that the truth tells right from wrong, if there are any."""
    if run.truth is None:
        return None
    try:
        found = run.localisation.as_dict()
    except InputError as error:
        if error.field != "truth":
            raise
        return None
    return {name: found[name] for name in ("scans", "wrong", "states", "doubtful_or_lost")}


def number(figures: Figures, name: str) -> float | None:
    """The value of a metric, if there is one."""
    found = figures["metrics"].get(name, {}).get("value")
    return None if found is None else float(found)


def beside(recording: Path, name: str) -> Path | None:
    """A file in a recording's folder, or beside a log, if it is there; in its name ``{}`` stands for the log's."""
    folder = recording if recording.is_dir() else recording.parent
    file = folder / name.format(recording.name.partition(".")[0])
    return file if file.exists() else None


def truth_file(recording: Path) -> Path | None:
    """The truth of a recording."""
    return beside(recording, "truth.tum")


def true_map_beside(recording: Path) -> Raster | None:
    """The true map of a recording."""
    file = beside(recording, "truth_map.yaml")
    return None if file is None else read_map(file)
