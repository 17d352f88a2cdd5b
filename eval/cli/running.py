"""One SLAM run as the command line does it: kernels started, progress shown, the result folder filled, scores said."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.eval.cli.evaluate import loop_lines
from moteslam.eval.cli.text import answer, progress_bar, warn
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE
from moteslam.eval.report.stages import Snapshots, TextureStages
from moteslam.eval.results import write_results
from moteslam.eval.scores import Figures, number
from moteslam.eval.tables import aligned, literal
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, counted
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate
from moteslam.slam.run import SlamSession, wants_colours, with_texture
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper

if TYPE_CHECKING:
    from moteslam.eval.cli.options import SlamOptions


@dataclass(frozen=True)
class Run:
    """A run that is done: its estimate, its figures as of ``metrics.json``, and all issues of recording and run."""

    estimate: Estimate
    figures: Figures
    issues: tuple[Issue, ...]


def run_into(
    folder: Path,
    recording: Recording,
    config: SlamConfig,
    options: SlamOptions,
    *,
    truth: Trajectory | None = None,
    true_map: Raster | None = None,
    about: dict[str, Any] | None = None,
    issues: tuple[Issue, ...] = (),
) -> Run:
    """Run SLAM over a recording and fill a result folder, which exists.

    It is scored with the truth, and its map with the true one, trinary and in the frame of the truth. ``about`` goes
    into ``run.json``; ``issues`` were found before the run, those of the recording and of SLAM follow.
    """
    from moteslam.kernels import runtime

    began, clock = datetime.now(UTC), time.perf_counter()
    device = runtime.init(options.arch, options.threads)
    session = SlamSession(recording, config, seed=options.seed)
    snapshots = Snapshots(session)
    with progress_bar("SLAM", len(session), "scans") as progress:
        for update in session:
            if not options.no_figures:
                snapshots.look(update)
            progress(update.index + 1)
    with progress_bar("final path and map", 1.0):
        estimate = session.estimate()
    seconds = time.perf_counter() - clock
    estimate, stages = _coloured(estimate, session.recording)
    issues = (*issues, *session.recording.warnings, *estimate.warnings)
    warn(issues)
    found = write_results(
        folder,
        estimate,
        truth,
        recording=session.recording,
        true_map=true_map,
        snapshots=snapshots.kept,
        stages=stages,
        figures=not options.no_figures,
        run={
            **(about or {}),
            "warnings": [issue.as_dict() for issue in issues],
            "command": ["moteslam", *sys.argv[1:]],
            "started": began.isoformat(timespec="seconds"),
            "slam_seconds": seconds,
            "arch": device.arch,
            "threads": device.threads,
        },
    )
    return Run(estimate, found, issues)


def _coloured(estimate: Estimate, recording: Recording) -> tuple[Estimate, list[tuple[float, TextureMap]]]:
    """The estimate with the coloured floor, if the recording has images, and the floor at stages of the run."""
    if not wants_colours(estimate.config, recording):
        return estimate, []
    path = estimate.trajectory_final
    stages = TextureStages(float(path.stamps[0]), float(path.stamps[-1]))
    span = max(stages.end - stages.begin, 1e-9)
    with progress_bar("floor", 1.0) as progress:

        def watch(stamp: float, mapper: TextureMapper) -> None:
            stages.look(stamp, mapper)
            progress(min(max((stamp - stages.begin) / span, 0.0), 1.0))

        estimate = with_texture(estimate, recording, watch=watch)
    return estimate, stages.kept if estimate.texture is not None else []


def say_run(run: Run, out: Path, driven: str, *, as_json: bool) -> None:
    """Print a run: what was driven, how many scans and particles, where the robot was lost, and the scores."""
    found = {
        "out": str(out),
        "recording": run.estimate.name,
        "seed": run.estimate.seed,
        "filter_and_back_end_seconds": run.estimate.seconds,
        "warnings": [issue.as_dict() for issue in run.issues],
        **run.figures,
    }
    answer(found, _lines(run, out, driven), as_json=as_json)


def _lines(run: Run, out: Path, driven: str) -> Iterator[str]:
    estimate, stamps, figures = run.estimate, run.estimate.trajectory.stamps, run.figures
    counts, lost = estimate.diagnostics["particles"], figures["localisation"]
    particles = counted(int(counts.max()), "particle")
    if counts.min() < counts.max():
        particles = f"{counts.mean():.0f} of {particles} in the mean"
    scans = f"{counted(len(stamps), 'scan')}, {particles}, {1000 * estimate.seconds / len(stamps):.1f} ms a scan"
    yield f"{literal(driven)} in {stamps[-1] - stamps[0]:.0f} s, {scans}"
    if lost["first_lost_stamp"] is not None:
        after = lost["first_lost_stamp"] - stamps[0]
        yield f"lost at {counted(lost['states']['lost'], 'scan')}, first after {after:.1f} s: see diagnostics.csv"
    if number(figures, "final.ate") is not None:
        yield from score_lines(figures)
    yield f"result in {literal(out)}"


def score_lines(figures: Figures) -> Iterator[str]:
    """The absolute error, and the relative error over 1 m, which is drift a metre; then the scores of loops."""
    rows: list[tuple[str, ...]] = [("", "ATE RMSE", "median", "max", "heading RMSE", "RPE over 1 m")]
    columns = [("ate", 100, ".1f", "cm"), ("ate_median", 100, ".1f", "cm"), ("ate_max", 100, ".1f", "cm")]
    columns += [("heading", 1, ".2f", "deg"), ("rpe_1m", 100, ".2f", "cm")]
    for name, track in (("dead reckoning", DEAD_RECKONING), ("SLAM (online)", ONLINE), ("SLAM (final)", FINAL)):
        cells = []
        for metric, factor, form, unit in columns:
            value = number(figures, f"{track}.{metric}")
            cells.append("-" if value is None else f"{factor * value:{form}} {unit}")
        rows.append((name, *cells))
    yield aligned(rows)
    if "loops" in figures:
        shares = {name: number(figures, f"loops_{name}") for name in ("precision", "recall", "false")}
        yield from loop_lines(figures["loops"] | shares)
