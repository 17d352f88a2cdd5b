"""``moteslam convert``: a recording, a part of it, or a trajectory, in another format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.errors import ConfigError
from moteslam.eval.cli import options
from moteslam.eval.cli.convert_trajectory import convert_trajectory, stands_for_trajectory
from moteslam.eval.cli.recording_options import RecordingOptions
from moteslam.eval.cli.text import say, say_json, warn
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from contextlib import AbstractContextManager


@options.with_options(part=RecordingOptions)
def convert(
    path: Annotated[Path, typer.Argument(metavar="IN", help="A recording or a trajectory of any format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="What is written; it must not exist.")],
    to: Annotated[
        str | None, typer.Option(metavar="FORMAT", help="Where OUT's ending does not say it: ucsd, rosbag2, ...")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing OUT, whole, at the end.")] = False,
    as_json: options.Json = False,
    *,
    part: RecordingOptions,
) -> None:
    """Write a recording, a part of it, or a trajectory in another format.

    The ending of OUT says which: .log, .log.gz (carmen), .toml (csv, and .csv files beside it), .bag, .mcap; rosbag2
    and ucsd are folders, to be named with --to. Of trajectories, which are kept in the plane: .tum, .kitti (and its
    .times.txt), .csv (euroc), .g2o.

    What the new format cannot hold is printed on stderr. A truth beside the recording is no part of it and stays there.

    \b
    Examples:
      moteslam convert robot.bag robot.log.gz
      moteslam convert robot.log.gz part.mcap --start 20 --end 80 --every 2
      moteslam convert simulated robot --to rosbag2 --streams lidar,odometry
      moteslam convert result/trajectory.tum trajectory.g2o
    """  # noqa: D301
    from moteslam.robot.trajectories import is_trajectory

    if is_trajectory(path) or stands_for_trajectory(out, to):
        if part.given:
            raise ConfigError("of a recording, expected none for a trajectory", field=part.given[0])
        convert_trajectory(path, out, to, force=force, as_json=as_json)
        return

    from moteslam.eval.beside import truth_file
    from moteslam.robot.formats import format_to_write
    from moteslam.robot.inspection import stream_reports

    try:
        name, known = format_to_write(out, to)
    except ConfigError as error:
        raise ConfigError(error.problem, field="--to") from error
    assert known.write is not None
    with _place(out, is_folder=known.is_folder, force=force, keep=path) as place:
        recording = part.open(path)
        issues = (*recording.warnings, *known.write(place, recording))
    truth = truth_file(path)
    if as_json:
        streams = {stream.name: stream.readings for stream in stream_reports(recording)}
        about = {"out": str(out), "format": name, "recording": recording.name, "readings": streams}
        beside = {"truth": None if truth is None else str(truth)}
        say_json({**about, **beside, "warnings": [issue.as_dict() for issue in issues]})
        return
    warn(issues)
    counts = ", ".join(f"{stream.name} {stream.readings}" for stream in stream_reports(recording))
    say(f"{literal(recording.name)}: readings of {counts}")
    say(f"wrote {literal(out)}, {name}")
    if truth is not None:
        say(f"the truth stays where it is: moteslam evaluate TRAJECTORY {literal(truth)}")


def _place(out: Path, *, is_folder: bool, force: bool, keep: Path) -> AbstractContextManager[Path]:
    """Where to write a file or folder that appears under its name when it is whole."""
    from moteslam.robot.files import result_folder, staged_file

    make = result_folder if is_folder else staged_file
    return make(out, force=force, keep=keep)
