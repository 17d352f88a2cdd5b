"""``moteslam inspect``: what a recording holds, and what is wrong with it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.eval.cli import options
from moteslam.eval.cli.inspect_figures import figures, or_dash
from moteslam.eval.cli.text import say, say_json, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import Platform


def inspect(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A log file, or a folder of arrays.")],
    sequence: options.Sequence = None,
    platform: options.PlatformFile = None,
    as_json: options.Json = False,
) -> None:
    """Print what a recording holds, what is measured of its sensors, and what is wrong with it.

    The column "platform" has what the recording's robot is known for.

    \b
    Examples:
      moteslam inspect robot.log.gz
      moteslam inspect ucsd --sequence 20 --json
    """  # noqa: D301
    from moteslam.robot.formats import open_recording
    from moteslam.robot.inspection import inspect_recording

    recording = open_recording(path, sequence=sequence, platform=platform)
    found = inspect_recording(recording)
    if as_json:
        say_json(found.to_dict())
    else:
        _print(found, recording.platform)


def _print(found: Inspection, platform: Platform) -> None:
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
    if found.wheels is not None:
        say(f"wheels: {or_dash(found.wheels.distance, '{:.1f} m')} driven, {found.wheels.at_rest:.1f} s at rest")
    if found.odometry_distance is not None:
        say(f"odometry: {found.odometry_distance:.1f} m driven")
    for problem in found.problems:
        say(f"problem: {literal(problem)}")
    if not found.problems:
        say("no problems")
