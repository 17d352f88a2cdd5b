"""One SLAM run as the command line does it: kernels started, progress shown, the result folder filled."""

from __future__ import annotations

import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from math import degrees
from pathlib import Path
from typing import Any

from moteslam.eval.cli.progress import progress_bar, working
from moteslam.eval.cli.text import table, warn
from moteslam.eval.diagnostics_table import localisation_summary
from moteslam.eval.report.snapshots import Snapshot, Snapshots
from moteslam.eval.report.textures import TextureStages
from moteslam.eval.results import write_results
from moteslam.eval.scores import Scores
from moteslam.robot.issues import Issue
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.wording import counted
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.run import SlamSession, wants_colours, with_texture
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper


@dataclass(frozen=True)
class Device:
    """Where the kernels run: ``cpu`` or ``cuda``, and on how many threads (None: all cores)."""

    arch: str = "cpu"
    threads: int | None = None

    def start(self) -> dict[str, Any]:
        """Start it; what it came to, for ``run.json``.

        Raises:
            BackendError: it is not there.
        """
        from moteslam.kernels.runtime import init

        runtime = init(self.arch, self.threads)
        return {"arch": runtime.arch, "threads": runtime.threads}


@dataclass(frozen=True)
class Run:
    """What a run came to: the estimate, its scores (None without truth), and all issues of recording and run."""

    estimate: Estimate
    scores: Scores | None
    issues: tuple[Issue, ...]


def run_into(
    folder: Path,
    recording: Recording,
    config: SlamConfig,
    *,
    seed: int,
    device: Device,
    truth: Trajectory | None = None,
    true_map: Raster | None = None,
    figures: bool = True,
    about: dict[str, Any] | None = None,
    issues: tuple[Issue, ...] = (),
) -> Run:
    """Run SLAM over a recording and fill a result folder, which exists.

    Args:
        folder: of the result.
        recording: what the sensors saw.
        config, seed, device: how it is run.
        truth: what to score it with.
        true_map: likewise, trinary, in the frame of the truth.
        figures: draw them.
        about: more for ``run.json``.
        issues: found before the run; those of the recording and of SLAM follow.

    Raises:
        MoteslamError: whatever is wrong with the recording, the configuration, the device or the folder.
    """
    started = Started(device)
    session = SlamSession(recording, config, seed=seed)
    snapshots = Snapshots(session)
    with progress_bar("SLAM", len(session), "scans") as bar:
        for update in session:
            if figures:
                snapshots.look(update)
            bar.update(update.index + 1)
    return finish_into(
        folder,
        session,
        started,
        truth=truth,
        true_map=true_map,
        snapshots=snapshots.kept,
        figures=figures,
        about=about,
        issues=issues,
    )


class Started:
    """When a run began, and what it runs on: for ``run.json``.

    Raises:
        BackendError: the device is not there.
    """

    def __init__(self, device: Device) -> None:
        self._began, self._clock = datetime.now(UTC), time.perf_counter()
        self._runs_on = device.start()

    @property
    def seconds(self) -> float:
        """Since then [s]."""
        return time.perf_counter() - self._clock

    def about(self, seconds: float) -> dict[str, Any]:
        """The command, its start, and what it took."""
        return {
            "command": ["moteslam", *sys.argv[1:]],
            "started": self._began.isoformat(timespec="seconds"),
            "slam_seconds": seconds,
            **self._runs_on,
        }


def finish_into(
    folder: Path,
    session: SlamSession,
    started: Started,
    *,
    truth: Trajectory | None = None,
    true_map: Raster | None = None,
    snapshots: Sequence[Snapshot] = (),
    figures: bool = True,
    about: dict[str, Any] | None = None,
    issues: tuple[Issue, ...] = (),
) -> Run:
    """Fill a result folder with what a session that has taken in its recording came to.

    Args:
        folder: of the result, which exists.
        session: at its end.
        started: when the run began.
        truth, true_map, figures, about, issues: as of `run_into`.
        snapshots: of the map over time.

    Raises:
        MoteslamError: whatever is wrong with the folder.
    """
    with working("final path and map"):
        estimate = session.estimate()
    seconds, recording = started.seconds, session.recording
    estimate, stages = _coloured(estimate, recording)
    issues = (*issues, *recording.warnings, *estimate.warnings)
    warn(issues)
    scores = write_results(
        folder,
        estimate,
        truth,
        recording=recording,
        true_map=true_map,
        snapshots=snapshots,
        stages=stages,
        figures=figures,
        run={
            **(about or {}),
            "warnings": [issue.as_dict() for issue in issues],
            **started.about(seconds),
        },
    )
    return Run(estimate, scores, issues)


def _coloured(estimate: Estimate, recording: Recording) -> tuple[Estimate, list[tuple[float, TextureMap]]]:
    """The estimate with the coloured floor, if the recording has images, and the floor at stages of the run."""
    if not wants_colours(estimate.config, recording):
        return estimate, []
    path = estimate.trajectory_final
    stages = TextureStages(float(path.stamps[0]), float(path.stamps[-1]))
    span = max(stages.end - stages.begin, 1e-9)
    with progress_bar("floor", 1.0, "") as bar:

        def watch(stamp: float, mapper: TextureMapper) -> None:
            stages.look(stamp, mapper)
            bar.update(min(max((stamp - stages.begin) / span, 0.0), 1.0))

        estimate = with_texture(estimate, recording, watch=watch)
    return estimate, stages.kept if estimate.texture is not None else []


def score_table(scores: Scores) -> str:
    """The scores as a small table: absolute error, and relative error over 1 m, which is drift a metre.

    Below it, where the back end looked for loops, their precision and recall.
    """
    rows: list[tuple[str, ...]] = [("", "ATE RMSE", "median", "max", "heading RMSE", "RPE over 1 m")]
    for name, score in (
        ("dead reckoning", scores.dead_reckoning),
        ("SLAM (online)", scores.online),
        ("SLAM (final)", scores.final),
    ):
        ate = score.ate
        over_1m = "-" if score.rpe_1m is None else f"{100 * score.rpe_1m.rmse:.2f} cm"
        rows.append(
            (
                name,
                *(f"{100 * value:.1f} cm" for value in (ate.rmse, ate.median, ate.max)),
                "-" if ate.rotation is None else f"{degrees(ate.rotation.rmse):.2f} deg",
                over_1m,
            )
        )
    errors = table(rows, right=(1, 2, 3, 4, 5))
    if scores.loops is None:
        return errors
    from moteslam.eval.cli.evaluate_tables import loop_lines

    return f"{errors}\n{loop_lines(scores.loops)}"


def size_of(estimate: Estimate) -> str:
    """How many scans and particles a run had, in words."""
    counts = estimate.diagnostics["particles"]
    most = counted(int(counts.max()), "particle")
    particles = most if counts.min() == counts.max() else f"{counts.mean():.0f} of {most} in the mean"
    return f"{counted(len(estimate.trajectory), 'scan')}, {particles}"


def lost_line(estimate: Estimate) -> str | None:
    """Where the robot was lost, in one line; None if it never was."""
    found = localisation_summary(estimate)
    if found["first_lost_stamp"] is None:
        return None
    scans, after = counted(found["states"]["lost"], "scan"), found["first_lost_stamp"] - estimate.trajectory.stamps[0]
    return f"lost at {scans}, first after {after:.1f} s: see diagnostics.csv"


def run_summary(run: Run, folder: Path) -> dict[str, Any]:
    """What ``--json`` prints of a run."""
    estimate, scores = run.estimate, run.scores
    return {
        "out": str(folder),
        "recording": estimate.name,
        "seed": estimate.seed,
        "scans": len(estimate.trajectory),
        "distance_m": estimate.trajectory_final.length,
        "filter_and_back_end_seconds": estimate.seconds,
        "localisation": localisation_summary(estimate),
        "scores": None if scores is None else scores.as_dict(),
        "warnings": [issue.as_dict() for issue in run.issues],
    }
