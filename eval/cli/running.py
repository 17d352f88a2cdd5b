"""One SLAM run as the command line does it: kernels started, progress shown, the result folder filled, scores said."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any

from moteslam.eval.cli.text import progress_bar, say, say_json, table, warn
from moteslam.eval.literal import literal
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE
from moteslam.eval.report.maps import Snapshots, TextureStages
from moteslam.eval.results import write_results
from moteslam.eval.scores import Figures, number
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

    Args:
        folder: of the result.
        recording: what the sensors saw.
        config, options: how it is run: seed, device, figures.
        truth: what to score it with.
        true_map: likewise, trinary, in the frame of the truth.
        about: more for ``run.json``.
        issues: found before the run; those of the recording and of SLAM follow.

    Raises:
        MoteslamError: whatever is wrong with the recording, the configuration, the device or the folder.
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
    estimate, stamps, figures = run.estimate, run.estimate.trajectory.stamps, run.figures
    if as_json:
        say_json(
            {
                "out": str(out),
                "recording": estimate.name,
                "seed": estimate.seed,
                "filter_and_back_end_seconds": estimate.seconds,
                "warnings": [issue.as_dict() for issue in run.issues],
                **figures,
            }
        )
        return
    counts, lost = estimate.diagnostics["particles"], figures["localisation"]
    particles = counted(int(counts.max()), "particle")
    if counts.min() < counts.max():
        particles = f"{counts.mean():.0f} of {particles} in the mean"
    scans = f"{counted(len(stamps), 'scan')}, {particles}, {1000 * estimate.seconds / len(stamps):.1f} ms a scan"
    say(f"{literal(driven)} in {stamps[-1] - stamps[0]:.0f} s, {scans}")
    if lost["first_lost_stamp"] is not None:
        after = lost["first_lost_stamp"] - stamps[0]
        say(f"lost at {counted(lost['states']['lost'], 'scan')}, first after {after:.1f} s: see diagnostics.csv")
    if number(figures, "final.ate") is not None:
        say(score_table(figures))
    say(f"result in {literal(out)}")


def score_table(figures: Figures) -> str:
    """The scores as a small table: absolute error, and relative error over 1 m, which is drift a metre.

    Below it, where the back end looked for loops, their precision and recall.
    """
    rows: list[tuple[str, ...]] = [("", "ATE RMSE", "median", "max", "heading RMSE", "RPE over 1 m")]
    for name, track in (("dead reckoning", DEAD_RECKONING), ("SLAM (online)", ONLINE), ("SLAM (final)", FINAL)):
        lengths = [number(figures, f"{track}.{metric}") for metric in ("ate", "ate_median", "ate_max", "rpe_1m")]
        ate, median, most = ("-" if length is None else f"{100 * length:.1f} cm" for length in lengths[:3])
        heading = number(figures, f"{track}.heading")
        over_1m = "-" if lengths[3] is None else f"{100 * lengths[3]:.2f} cm"
        rows.append((name, ate, median, most, "-" if heading is None else f"{heading:.2f} deg", over_1m))
    errors = table(rows, right=(1, 2, 3, 4, 5))
    if "loops" not in figures:
        return errors
    from moteslam.eval.cli.evaluate_tables import loop_lines

    shares = {name: number(figures, f"loops_{name}") for name in ("precision", "recall", "false")}
    return f"{errors}\n{loop_lines(figures['loops'] | shares)}"
