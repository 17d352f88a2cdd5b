"""``moteslam inspect``: what a recording holds, and what is wrong with it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import answer
from moteslam.eval.tables import aligned, literal

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import Platform
    from moteslam.robot.recording import Recording
    from moteslam.robot.sensor_reports import LidarReport
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.findings import Findings

NONE = "-"
"""Stands for what cannot be measured, or what the platform has not."""
Row = tuple[str, str, str]
"""Of the sensors: a figure's name, as measured, and by the platform of the recording."""


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
    the odometry: what of lidar and odometry is certainly not as stated is a problem, with what mends it. Of a bag some
    hundred scans are read for it; with --deep all are measured, and images looked at; --plot reads all to draw them.

    \b
    Examples:
      moteslam inspect robot.log.gz
      moteslam inspect robot.bag --deep --plot robot.png
      moteslam inspect ucsd --sequence 20 --json
    """  # noqa: D301
    with options.new_file(plot, ".png", force=force):
        whole, lines = _inspected(part.open(path), deep=deep, plot=plot)
    answer(whole, lines, as_json=as_json)


def _inspected(recording: Recording, *, deep: bool, plot: Path | None) -> tuple[dict[str, Any], Iterator[str]]:
    """All that is found, as JSON has it and in words."""
    import numpy as np

    from moteslam.robot.inspection import inspect_recording
    from moteslam.slam.calibration.calibrate import calibrate
    from moteslam.slam.calibration.findings import findings

    found = inspect_recording(recording, deep=deep)
    about: Findings | None = None
    stale: tuple[Issue, ...] = ()
    if recording.lidar is not None:
        calibration = calibrate(recording)
        about = None if calibration is None else findings(calibration, recording)
        if deep or isinstance(recording.lidar.ranges, np.ndarray):
            stale = _stale(recording)
    more = stale if about is None else (*stale, *about.issues)
    known = {issue.code for issue in more}
    kept = [issue for issue in found.problems if not (issue.code in known and issue.message.startswith("lidar:"))]
    found = replace(found, problems=(*kept, *more))
    if plot is not None:
        from moteslam.eval.report.streams import draw_streams

        draw_streams(plot, recording, found)
    whole = {**found.to_dict(), "calibration": None if about is None else [asdict(one) for one in about.figures]}
    return whole, _lines(found, recording.platform, about)


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


def _lines(found: Inspection, platform: Platform, about: Findings | None) -> Iterator[str]:
    from moteslam.slam.calibration.findings import WITHIN

    yield f"{literal(found.name)} (platform {literal(found.platform)})"
    rows = [("stream", "readings", "duration", "rate", "longest gap", "gaps", "equal stamps")]
    for each in found.streams:
        rate, gap = _shown(each.mean_rate, ".1f", "Hz"), _shown(each.largest_gap, ".3f", "s")
        counts = (str(each.gaps), str(each.equal_stamps))
        rows.append((each.name, str(each.readings), f"{each.duration:.1f} s", rate, gap, *counts))
    yield aligned(rows)
    if measured := list(_sensors(found, platform)):
        yield aligned([("sensors", "measured", "platform"), *measured])
    if about is not None:
        held = [("by scans and odometry", "measured", "within, 95 %", "stated")]
        for one in about.figures:
            held.append((one.name, f"{one.value:.4f}", f"+-{WITHIN * one.deviation:.4f}", f"{one.stated:g}"))
        yield aligned(held)
    if found.wheels is not None:
        yield f"wheels: {_shown(found.wheels.distance, '.1f', 'm')} driven, {found.wheels.at_rest:.1f} s at rest"
    if found.odometry_distance is not None:
        yield f"odometry: {found.odometry_distance:.1f} m driven"
    for clock in found.clocks:
        after = f"{1000 * clock.offset:+.0f} ms after those by the {clock.reference}"
        yield f"clock: turns by the {clock.name} {after}, correlation {clock.correlation:.2f}"
    for problem in found.problems:
        yield f"problem: {literal(problem)}"
    if about is not None and about.issues:
        yield "what is certain of lidar and odometry is mended by replay --calibrate lidar, or odometry"
    if not found.problems:
        yield "no problems"


def _sensors(found: Inspection, platform: Platform) -> Iterator[Row]:
    rates = {stream.name: stream.mean_rate for stream in found.streams}
    if found.lidar is not None:
        yield from _lidar(found.lidar, rates.get("lidar"), platform)
    if found.wheels is not None:
        stated = None if platform.encoders is None else platform.encoders.rate
        yield "encoder rate", _shown(rates.get("encoders"), ".1f", "Hz"), _shown(stated, "g", "Hz")
        yield "encoder counts FR FL RR RL", " ".join(map(str, found.wheels.counts)), NONE
    if "imu" in rates:
        stated = None if platform.imu is None else platform.imu.rate
        yield "IMU rate", _shown(rates["imu"], ".1f", "Hz"), _shown(stated, "g", "Hz")
    if (gyro := found.gyro_at_rest) is not None:
        noise = None if platform.imu is None else platform.noise.imu
        bias, deviation = (None, None) if noise is None else (noise.gyro_bias, noise.gyro_noise)
        for name, value, known in (("mean", gyro.mean, bias), ("noise", gyro.deviation, deviation)):
            yield f"gyro at rest, {name}", _shown(value, ".5f", "rad/s"), _shown(known, ".5f", "rad/s")


def _lidar(found: LidarReport, rate: float | None, platform: Platform) -> Iterator[Row]:
    spec, at_rest = platform.lidar, found.noise_at_rest
    noise = platform.noise.lidar if spec.rate is not None else None  # one that gives no rate gives no noise either
    turns = NONE
    if spec.angle_increment is not None:
        turns = "clockwise" if spec.angle_increment < 0 else "counterclockwise"
    resolution, dropout = (None, None) if noise is None else (noise.resolution, noise.dropout)
    deviation, expected, at = None, None, "at rest"
    if at_rest is not None:
        deviation, at = at_rest.deviation, f"at {at_rest.at_range:.2f} m, at rest"
        if noise is not None:
            expected = noise.range_noise + noise.range_noise_per_metre * at_rest.at_range
    beams = -(-found.beams // found.interlace)
    interlaced = f"{beams} of {found.beams}" if found.interlace > 1 else str(beams)
    yield "lidar beams", interlaced, _shown(spec.beams, "")
    yield "first beam", _degrees(found.angle_min), _degrees(spec.angle_min)
    yield "between beams", _degrees(found.angle_increment), _degrees(spec.angle_increment)
    yield "turns", found.turns, turns
    yield "scan rate", _shown(rate, ".2f", "Hz"), _shown(spec.rate, "g", "Hz")
    yield "shortest limit", _shown(found.range_min, "g", "m"), _shown(spec.range_min, "g", "m")
    yield "longest limit", _shown(found.range_max, "g", "m"), _shown(spec.range_max, "g", "m")
    yield "nearest endpoint", _shown(found.nearest, ".3f", "m"), NONE
    yield "farthest endpoint", _shown(found.farthest, ".3f", "m"), NONE
    yield "range resolution", _shown(found.resolution, ".3g", "mm", 1000), _shown(resolution, ".3g", "mm", 1000)
    yield f"range noise {at}", _shown(deviation, ".3g", "mm", 1000), _shown(expected, ".3g", "mm", 1000)
    yield "dropouts", _shown(found.invalid, ".2f", "%", 100), _shown(dropout, ".2f", "%", 100)
    yield "no return", _shown(found.no_return, ".2f", "%", 100), NONE


def _degrees(angle: float | None) -> str:
    return NONE if angle is None else f"{degrees(angle):.4g} deg"


def _shown(value: float | None, form: str, unit: str = "", factor: float = 1) -> str:
    return NONE if value is None else f"{factor * value:{form}} {unit}".rstrip()
