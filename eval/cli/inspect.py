"""``moteslam inspect``: what a recording holds, and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.inspect_figures import calibration_row, figures, or_dash
from moteslam.eval.cli.recording_options import RecordingOptions
from moteslam.eval.cli.text import say, say_json, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import Platform
    from moteslam.robot.recording import Recording
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.findings import Findings


@options.with_options(part=RecordingOptions)
def inspect(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A log file, a bag, or a folder of arrays.")],
    deep: Annotated[bool, typer.Option("--deep", help="Read all ranges of a bag, and all images.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw streams, gaps, rates, clocks and ranges over time.")
    ] = None,
    force: options.ForceFile = False,
    as_json: options.Json = False,
    *,
    part: RecordingOptions,
) -> None:
    """Print what a recording holds, what is measured of its sensors, and what is wrong with it.

    The column "platform" has what the recording's robot is known for. Scans are held against each other and against
    the odometry: what of lidar and odometry is certainly not as stated is a problem, with what mends it. Ranges of a
    bag are measured with --deep, and held against its odometry; --plot reads them to draw them. Without either a bag's
    ranges and images stay unread.

    \b
    Examples:
      moteslam inspect robot.log.gz
      moteslam inspect robot.bag --deep --plot robot.png
      moteslam inspect ucsd --sequence 20 --json
    """  # noqa: D301
    import numpy as np

    from moteslam.robot.inspection import inspect_recording
    from moteslam.slam.calibration.calibrate import calibrate
    from moteslam.slam.calibration.findings import findings

    if plot is not None:
        options.expect_picture(plot)
        options.refuse_existing(plot, force=force)
    recording = part.open(path)
    found = inspect_recording(recording, deep=deep)
    about: Findings | None = None
    stale: tuple[Issue, ...] = ()
    if recording.lidar is not None and (deep or isinstance(recording.lidar.ranges, np.ndarray)):
        calibration = calibrate(recording)
        about = None if calibration is None else findings(calibration, recording)
        stale = _stale(recording)
    more = stale if about is None else (*stale, *about.issues)
    known = {issue.code for issue in more}
    kept = [issue for issue in found.problems if not (issue.code in known and issue.message.startswith("lidar:"))]
    found = replace(found, problems=(*kept, *more))
    if plot is not None:
        from moteslam.eval.report.streams import draw_streams
        from moteslam.robot.files import folder_for

        with folder_for(plot):
            draw_streams(plot, recording, found)
    if as_json:
        say_json({**found.to_dict(), "calibration": None if about is None else [asdict(one) for one in about.figures]})
    else:
        _print(found, recording.platform, about)


def _stale(recording: Recording) -> tuple[Issue, ...]:
    """Where the odometry stood still while the robot drove."""
    from moteslam.errors import InputError
    from moteslam.slam.inputs.config import SyncConfig
    from moteslam.slam.inputs.synchronise import synchronise

    try:
        issues = synchronise(recording, SyncConfig(travelling=False, deskew=False)).issues
    except InputError:  # no scans, or no odometry at their time: said elsewhere
        return ()
    return tuple(issue for issue in issues if issue.code == "stale-odometry")


def _print(found: Inspection, platform: Platform, about: Findings | None) -> None:
    say(f"{literal(found.name)} (platform {literal(found.platform)})")
    rows = [("stream", "readings", "duration", "rate", "longest gap", "gaps", "equal stamps")]
    for stream in found.streams:
        rows.append(
            (
                stream.name,
                str(stream.readings),
                f"{stream.duration:.1f} s",
                or_dash(stream.mean_rate, "{:.1f} Hz"),
                or_dash(stream.largest_gap, "{:.3f} s"),
                str(stream.gaps),
                str(stream.equal_stamps),
            )
        )
    say(table(rows, right=range(1, 7)))
    if measured := figures(found, platform):
        say(table([("sensors", "measured", "platform"), *measured], right=(1, 2)))
    if about is not None:
        head = ("by scans and odometry", "measured", "within, 95 %", "stated")
        say(table([head, *map(calibration_row, about.figures)], right=(1, 2, 3)))
    if found.wheels is not None:
        say(f"wheels: {or_dash(found.wheels.distance, '{:.1f} m')} driven, {found.wheels.at_rest:.1f} s at rest")
    if found.odometry_distance is not None:
        say(f"odometry: {found.odometry_distance:.1f} m driven")
    for clock in found.clocks:
        say(
            f"clock: turns by the {clock.name} {1000 * clock.offset:+.0f} ms after those by the {clock.reference}, "
            f"correlation {clock.correlation:.2f}"
        )
    for problem in found.problems:
        say(f"problem: {literal(problem)}")
    if about is not None and about.issues:
        say("what is certain of lidar and odometry is mended by replay --calibrate lidar, or odometry")
    if not found.problems:
        say("no problems")
