"""``moteslam convert``: a recording, or a part of it, in another format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.recording_options import RecordingOptions
from moteslam.eval.cli.text import say, say_json, warn
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.formats import Format
    from moteslam.robot.issues import Issue
    from moteslam.robot.recording import Recording


@options.with_options(part=RecordingOptions)
def convert(
    path: Annotated[Path, typer.Argument(metavar="IN", help="A recording of any format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="The new recording; it must not exist.")],
    to: Annotated[
        str | None, typer.Option(metavar="FORMAT", help="Where the ending of OUT does not say it: carmen, ucsd, ...")
    ] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing OUT, whole, at the end.")] = False,
    as_json: options.Json = False,
    *,
    part: RecordingOptions,
) -> None:
    """Write a recording, or a part of it, in another format.

    What the new format cannot hold is printed on stderr. A truth beside the recording is no part of it and stays there.

    \b
    Examples:
      moteslam convert robot.bag robot.log.gz
      moteslam convert robot.log.gz part.mcap --start 20 --end 80 --every 2
      moteslam convert simulated robot --to rosbag2 --streams lidar,odometry
    """  # noqa: D301
    from moteslam.robot.formats import format_to_write
    from moteslam.robot.inspection import stream_reports

    try:
        name, known = format_to_write(out, to)
    except ConfigError as error:
        raise ConfigError(error.problem, field="--to") from error
    recording = part.open(path)
    issues = (*recording.warnings, *_write(known, out, recording, force=force, keep=path))
    if as_json:
        streams = {stream.name: stream.readings for stream in stream_reports(recording)}
        about = {"out": str(out), "format": name, "recording": recording.name, "readings": streams}
        say_json({**about, "warnings": [issue.as_dict() for issue in issues]})
        return
    warn(issues)
    counts = ", ".join(f"{stream.name} {stream.readings}" for stream in stream_reports(recording))
    say(f"{literal(recording.name)}: readings of {counts}")
    say(f"wrote {literal(out)}, {name}")


def _write(known: Format, out: Path, recording: Recording, *, force: bool, keep: Path) -> tuple[Issue, ...]:
    """Write a file or folder, whole or not at all; what the format cannot hold.

    Raises:
        ExistsError: it is there already, without ``force``.
        OutputError: it cannot be written, or is the recording that is read.
        InputError: the format cannot hold such a recording.
    """
    from moteslam.robot.files import folder_for
    from moteslam.robot.result_folder import result_folder

    assert known.write is not None
    if known.is_folder:
        with result_folder(out, force=force, keep=keep) as folder:
            return known.write(folder, recording)
    options.refuse_existing(out, force=force)
    if out.exists() and out.samefile(keep):
        raise OutputError("is the recording that is read, expected another file", file=out)
    with folder_for(out):
        return known.write(out, recording)
