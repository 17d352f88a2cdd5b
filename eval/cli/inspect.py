"""``moteslam inspect``: what a recording holds, and what is wrong with it."""

from __future__ import annotations

from dataclasses import asdict, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import say, say_json, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import Platform
    from moteslam.robot.recording import Recording
    from moteslam.robot.sensor_reports import LidarReport
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.findings import Findings

NONE = "-"
"""Stands for what cannot be measured, or what the platform has not."""


@options.with_options(part=options.RecordingOptions)
def inspect(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A log file, a bag, or a folder of arrays.")],
    deep: Annotated[bool, typer.Option("--deep", help="Read all ranges of a bag, and all images.")] = False,
    plot: Annotated[
        Path | None, typer.Option(metavar="FILE.png", help="Draw streams, gaps, rates, clocks and ranges over time.")
    ] = None,
    force: options.ForceFile = False,
    as_json: options.Json = False,
    *,
    part: options.RecordingOptions,
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

    options.expect_new(plot, ".png", force=force)
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
                _or_dash(stream.mean_rate, "{:.1f} Hz"),
                _or_dash(stream.largest_gap, "{:.3f} s"),
                str(stream.gaps),
                str(stream.equal_stamps),
            )
        )
    say(table(rows, right=range(1, 7)))
    if measured := _sensors(found, platform):
        say(table([("sensors", "measured", "platform"), *measured], right=(1, 2)))
    if about is not None:
        from moteslam.slam.calibration.findings import WITHIN

        held = [("by scans and odometry", "measured", "within, 95 %", "stated")]
        for one in about.figures:
            held.append((one.name, f"{one.value:.4f}", f"+-{WITHIN * one.deviation:.4f}", f"{one.stated:g}"))
        say(table(held, right=(1, 2, 3)))
    if found.wheels is not None:
        say(f"wheels: {_or_dash(found.wheels.distance, '{:.1f} m')} driven, {found.wheels.at_rest:.1f} s at rest")
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


def _sensors(found: Inspection, platform: Platform) -> list[tuple[str, str, str]]:
    """What was measured of the sensors: a figure's name, as measured, and by the platform of the recording."""
    rates = {stream.name: stream.mean_rate for stream in found.streams}
    encoders, imu = (NONE if one is None else f"{one.rate:g} Hz" for one in (platform.encoders, platform.imu))
    rows = [] if found.lidar is None else _lidar(found.lidar, rates.get("lidar"), platform)
    if found.wheels is not None:
        rows.append(("encoder rate", _or_dash(rates.get("encoders"), "{:.1f} Hz"), encoders))
        rows.append(("encoder counts FR FL RR RL", " ".join(map(str, found.wheels.counts)), NONE))
    if "imu" in rates:
        rows.append(("IMU rate", _or_dash(rates["imu"], "{:.1f} Hz"), imu))
    if (gyro := found.gyro_at_rest) is not None:
        noise = None if platform.imu is None else platform.noise.imu
        bias, deviation = (None, None) if noise is None else (noise.gyro_bias, noise.gyro_noise)
        rows.append(("gyro at rest, mean", f"{gyro.mean:.5f} rad/s", _or_dash(bias, "{:.5f} rad/s")))
        rows.append(("gyro at rest, noise", f"{gyro.deviation:.5f} rad/s", _or_dash(deviation, "{:.5f} rad/s")))
    return rows


def _lidar(found: LidarReport, rate: float | None, platform: Platform) -> list[tuple[str, str, str]]:
    spec, noise, at_rest = platform.lidar, platform.noise.lidar, found.noise_at_rest
    known = spec.rate is not None  # a platform that gives no rate gives no noise either
    beams = -(-found.beams // found.interlace)
    turns = NONE
    if spec.angle_increment is not None:
        turns = "clockwise" if spec.angle_increment < 0 else "counterclockwise"
    expected, at = None, "at rest"
    if at_rest is not None:
        expected = noise.range_noise + noise.range_noise_per_metre * at_rest.at_range if known else None
        at = f"at {at_rest.at_range:.2f} m, at rest"
    return [
        ("lidar beams", f"{beams} of {found.beams}" if found.interlace > 1 else str(beams), _or_dash(spec.beams, "{}")),
        ("first beam", _angle(found.angle_min), _angle(spec.angle_min)),
        ("between beams", _angle(found.angle_increment), _angle(spec.angle_increment)),
        ("turns", found.turns, turns),
        ("scan rate", _or_dash(rate, "{:.2f} Hz"), _or_dash(spec.rate, "{:g} Hz")),
        ("shortest limit", f"{found.range_min:g} m", _or_dash(spec.range_min, "{:g} m")),
        ("longest limit", f"{found.range_max:g} m", _or_dash(spec.range_max, "{:g} m")),
        ("nearest endpoint", _or_dash(found.nearest, "{:.3f} m"), NONE),
        ("farthest endpoint", _or_dash(found.farthest, "{:.3f} m"), NONE),
        ("range resolution", _millimetres(found.resolution), _millimetres(noise.resolution if known else None)),
        (f"range noise {at}", _millimetres(None if at_rest is None else at_rest.deviation), _millimetres(expected)),
        ("dropouts", _percent(found.invalid), _percent(noise.dropout if known else None)),
        ("no return", _percent(found.no_return), NONE),
    ]


def _or_dash(value: float | None, form: str) -> str:
    return NONE if value is None else form.format(value)


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.2f} %"


def _angle(value: float | None) -> str:
    return NONE if value is None else f"{degrees(value):.4g} deg"


def _millimetres(value: float | None) -> str:
    return NONE if value is None else f"{1000 * value:.3g} mm"
