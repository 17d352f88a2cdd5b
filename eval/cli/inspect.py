"""``moteslam inspect``: what a recording holds, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.text import literal, say, say_json, table

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection


def inspect(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A log file, or a folder of arrays.")],
    sequence: options.Sequence = None,
    platform: options.PlatformFile = None,
    as_json: options.Json = False,
) -> None:
    """Print what a recording holds and what is wrong with it.

    \b
    Examples:
      moteslam inspect robot.log.gz
      moteslam inspect ucsd --sequence 20 --json
    """  # noqa: D301
    from moteslam.robot.formats import open_recording
    from moteslam.robot.inspection import inspect_recording

    found = inspect_recording(open_recording(path, sequence=sequence, platform=platform))
    if as_json:
        say_json(found.to_dict())
    else:
        _print(found)


def _print(found: Inspection) -> None:
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
    lidar = found.lidar
    if lidar is not None:
        say(
            f"lidar: {lidar.beams} beams over {lidar.field_of_view:.1f} deg, {lidar.range_min:g} to "
            f"{lidar.range_max:g} m; {100 * lidar.no_return:.1f} % without return, "
            f"{100 * lidar.invalid:.1f} % invalid, median range {_or_dash(lidar.median_range, '{:.2f} m')}"
        )
    if found.wheels is not None:
        say(f"wheels: {_or_dash(found.wheels.distance, '{:.1f} m')} driven, {found.wheels.at_rest:.1f} s at rest")
    if found.odometry_distance is not None:
        say(f"odometry: {found.odometry_distance:.1f} m driven")
    if found.gyro_at_rest is not None:
        gyro = found.gyro_at_rest
        say(f"gyro at rest: mean {gyro.mean:.5f} rad/s, standard deviation {gyro.deviation:.5f} rad/s")
    for problem in found.problems:
        say(f"problem: {literal(problem)}")
    if not found.problems:
        say("no problems")


def _or_dash(value: float | None, form: str) -> str:
    return "-" if value is None else form.format(value)
