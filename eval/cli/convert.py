"""``moteslam convert``: a recording, a part of it, or a trajectory, in another format."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.options import flag, opt
from moteslam.eval.cli.text import answer, warn
from moteslam.eval.tables import literal

if TYPE_CHECKING:
    from moteslam.robot.trajectory import Trajectory
    from moteslam.robot.values import Issue


@options.with_options(part=options.RecordingOptions)
def convert(
    path: Annotated[Path, typer.Argument(metavar="IN", help="A recording or a trajectory of any format.")],
    out: Annotated[Path, typer.Argument(metavar="OUT", help="What is written; it must not exist.")],
    to: Annotated[str | None, opt("Format, if OUT's ending does not say it: ucsd, rosbag2, ...", "FORMAT")] = None,
    force: Annotated[bool, flag("--force", "Replace an existing OUT, whole, at the end.")] = False,
    as_json: options.Json = False,
    *,
    part: options.RecordingOptions,
) -> None:
    """Write a recording, a part of it, or a trajectory in another format.

    The ending of OUT gives the format: .log, .log.gz (carmen), .toml (csv, and .csv files beside it), .bag, .mcap.
    The folders rosbag2 and ucsd need --to. Trajectories, which are projected to the plane, have .tum, .kitti (and
    its .times.txt), .csv (euroc), .g2o.

    What the new format cannot hold is printed on stderr. A truth beside the recording is not converted.

    \b
    Examples:
      moteslam convert robot.bag robot.log.gz
      moteslam convert robot.log.gz part.mcap --start 20 --end 80 --every 2
      moteslam convert simulated robot --to rosbag2 --streams lidar,odometry
      moteslam convert result/trajectory.tum trajectory.g2o
    """  # noqa: D301
    from moteslam.eval.scores import truth_file
    from moteslam.files import result_folder, staged_file
    from moteslam.robot.formats import format_to_write
    from moteslam.robot.inspection import stream_reports
    from moteslam.robot.trajectories import format_to_write as trajectory_format
    from moteslam.robot.trajectories import is_trajectory, write_trajectory
    from moteslam.robot.values import counted

    name, problem, truth = None, "", None
    try:
        name = trajectory_format(out, to)
    except (ConfigError, OutputError) as error:
        problem = error.problem
    found: dict[str, Any] = {"out": str(out), "format": name}
    if name is not None or is_trajectory(path):
        if part.given:
            raise ConfigError("of a recording, expected none for a trajectory", field=f"--{next(iter(part.given))}")
        if name is None:
            raise ConfigError(f"{path} is a trajectory: {problem}", field="--to")
        with staged_file(out, force=force, keep=path) as file:
            trajectory, issues = _read(path)
            write_trajectory(file, trajectory, name)
        found |= {"poses": len(trajectory), "distance_m": trajectory.length}
        line = f"{literal(path.name)}: {counted(len(trajectory), 'pose')}, {trajectory.length:.1f} m"
    else:
        with options.named("--to"):
            found["format"], known = format_to_write(out, to)
        assert known.write is not None
        with (result_folder if known.is_folder else staged_file)(out, force=force, keep=path) as place:
            recording = part.open(path)
            issues = (*recording.warnings, *known.write(place, recording))
        truth, readings = truth_file(path), {one.name: one.readings for one in stream_reports(recording)}
        found |= {"recording": recording.name, "readings": readings, "truth": None if truth is None else str(truth)}
        counts = ", ".join(f"{stream} {count}" for stream, count in readings.items())
        line = f"{literal(recording.name)}: readings of {counts}"
    if not as_json:
        warn(issues)
    lines = [line, f"wrote {literal(out)}, {found['format']}"]
    if truth is not None:
        lines.append(f"the truth stays where it is: moteslam evaluate TRAJECTORY {literal(truth)}")
    answer(found | {"warnings": [issue.as_dict() for issue in issues]}, lines, as_json=as_json)


def _read(path: Path) -> tuple[Trajectory, tuple[Issue, ...]]:
    import numpy as np

    from moteslam.robot.trajectories import is_g2o, read_trajectory
    from moteslam.robot.trajectories.text import read_g2o, read_vertices
    from moteslam.robot.values import Issue, counted

    graph = read_g2o(path) if is_g2o(path) else None
    trajectory = read_trajectory(path) if graph is None else read_vertices(path, graph)
    issues = trajectory.warnings
    if trajectory.space is not None:
        span = float(np.ptp(trajectory.space.positions[:, 2]))
        text = f"{path.name}: z, which spans {span:.2f} m, roll and pitch not written: poses are those in x and y"
        issues += (Issue("not-written", text, len(trajectory)),)
    if graph is not None and (edges := len(graph.first)):
        text = f"{path.name}: {counted(edges, 'edge')} not written, no part of a trajectory"
        issues += (Issue("not-written", text, edges),)
    return trajectory, issues
