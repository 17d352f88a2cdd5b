"""``moteslam inspect`` and ``convert``: what a recording holds and what is wrong with it, or it in another format."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, replace
from itertools import chain
from math import pi
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from moteslam.errors import ConfigError, InputError, OutputError
from moteslam.eval.cli import options
from moteslam.eval.cli.options import arg, flag, opt
from moteslam.eval.cli.text import answer, warn
from moteslam.eval.tables import Column, aligned, literal, rows_of

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import Platform
    from moteslam.robot.sensor_reports import LidarReport
    from moteslam.robot.trajectory import Trajectory
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.findings import Findings

NONE = "-"  # Stands for what cannot be measured, or what the platform has not
READ = 2_000_000  # Fewer ranges of a bag are all read: within a second or two
UNREAD = "blind or repeated scans, wheels that spin, what travels with the robot"
UNMEASURED = "nearest and farthest endpoint, noise, dropouts (-)"
Row = tuple[str, str, str]
"""Of the sensors: a figure's name, as measured, and by the platform of the recording."""
STREAMS = (
    *(Column("stream", "name"), Column("readings", "readings"), Column("duration", "duration", ".1f", "s")),
    *(Column("rate", "mean_rate", ".1f", "Hz"), Column("longest gap", "largest_gap", ".3f", "s")),
    *(Column("gaps", "gaps"), Column("equal stamps", "equal_stamps")),
)


@options.with_options(part=options.RecordingOptions)
def inspect(
    path: Annotated[Path, arg("A log file, a bag, or a folder of arrays.", "PATH")],
    deep: Annotated[bool, flag("--deep", "Read all ranges of a bag, and all images.")] = False,
    plot: Annotated[
        Path | None, opt("Draw streams, gaps, rates, clocks and ranges over time.", "FILE.png|pdf|svg")
    ] = None,
    force: options.ForceFile = False,
    as_json: options.Json = False,
    *,
    part: options.RecordingOptions,
) -> None:
    """Print what a recording holds, and what is wrong with it.

    The column "platform" has what is stated of the recording's robot. Scans are compared with each other and with the
    odometry. What is certainly stated wrongly of lidar or odometry is a problem, with what mends it, and so is all that
    SLAM would do without. Some hundred scans of a bag are measured, and of a large one only these are read. --deep
    reads all scans and images, --plot all scans.

    \b
    Examples:
      moteslam inspect robot.log.gz
      moteslam inspect robot.bag --deep --plot robot.png
      moteslam inspect ucsd --sequence 20 --json
    """  # noqa: D301
    import numpy as np

    from moteslam.robot.inspection import inspect_recording
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.checked import checked
    from moteslam.slam.calibration.findings import trusting
    from moteslam.slam.inputs.config import SyncConfig
    from moteslam.slam.inputs.synchronise import about_jumps, synchronise, warnings

    with options.new_file(plot, *options.FIGURES, force=force):
        recording, more, read, measured = part.open(path), tuple(part.about_each_lidar(path)), True, True
        found, about = inspect_recording(recording, deep=deep), checked(recording)[1]
        more += () if about is None else about.issues
        about = about if about is not None and about.figures else None
        if recording.lidar is not None:  # what a replay says of it
            measured = deep or isinstance(recording.lidar.ranges, np.ndarray)
            read = measured or recording.lidar.ranges.size < READ
            try:
                inputs = synchronise(recording, trusting(SyncConfig(travelling=read, deskew=False), more))
                more += tuple(one for one in warnings(recording, inputs, read_ranges=read) if one not in more)
                more += about_jumps(inputs.stamps, inputs.odometry, inputs.jumped)
            except InputError as error:
                more += (Issue("refused", f"SLAM refuses it: {error}"),)
        found = replace(found, problems=(*found.problems, *more))
        if plot is not None:
            from moteslam.eval.report.streams import draw_streams

            draw_streams(plot, recording, found)
    whole = {**found.to_dict(), "calibration": None if about is None else [asdict(one) for one in about.figures]}
    unread = ", ".join([UNMEASURED] * (not measured) + [UNREAD] * (not read))
    lines = chain(_lines(found, recording.platform, about), [f"only with --deep: {unread}"] if unread else ())
    answer(whole, lines, as_json=as_json)


def _lines(found: Inspection, platform: Platform, about: Findings | None) -> Iterator[str]:
    from moteslam.robot.inspection import LATE
    from moteslam.slam.calibration.findings import WITHIN

    yield f"{literal(found.name)} (platform {literal(found.platform)})"
    yield aligned(rows_of(STREAMS, map(asdict, found.streams)))
    if measured := list(_sensors(found, platform)):
        yield aligned([("sensors", "measured", "platform"), *measured])
    if about is not None:
        small = {each.name for each in about.figures if each.differs and not about.issues}  # which move others, too
        held = [
            (
                one.name,
                f"{one.value:.4f}",
                f"+-{WITHIN * one.deviation:.4f}",
                f"{one.stated:g}{' *' * (one.name in small)}",
            )
            for one in about.figures
        ]
        yield aligned([("by scans and odometry", "measured", "within, 95 %", "stated"), *held])
        if small:
            yield "* differs, by too little to move a result by a tenth of a metre"
    elif found.lidar is not None:
        yield "by scans and odometry: nothing measured: too few scans that fit or turn, no odometry, or a problem below"
    if found.wheels is not None:
        yield f"wheels: {_shown(found.wheels.distance, '.1f', 'm')} driven, {found.wheels.at_rest:.1f} s at rest"
    if found.odometry_distance is not None:
        yield f"odometry: {found.odometry_distance:.1f} m driven"
    for clock in found.clocks:
        late = f"{1000 * abs(clock.offset):.0f} ms {'after' if clock.offset >= 0 else 'before'}"
        late = late if abs(clock.offset) > LATE else f"within {LATE:g} s of"  # wheels that slip lead a gyro by as much
        late += f" those by the {clock.reference}, correlation {clock.correlation:.2f}"
        yield f"clock: turns by the {clock.name} {late}"
    for problem in found.problems:
        yield f"problem: {literal(problem)}"
    if about is not None and about.issues:
        yield "replay corrects what is certain; --calibrate lidar, or --calibrate odometry, what may be either"
    if not found.problems:
        yield "no problems"


def _sensors(found: Inspection, platform: Platform) -> Iterator[Row]:
    rates = {stream.name: stream.mean_rate for stream in found.streams}
    if found.lidar is not None:
        yield from _lidar(found.lidar, rates.get("lidar"), platform)
    if found.wheels is not None:
        rate = _shown(rates.get("encoders"), ".1f", "Hz")
        yield "encoder rate", rate, _shown(getattr(platform.encoders, "rate", None), "g", "Hz")
        yield "encoder counts FR FL RR RL", " ".join(map(str, found.wheels.counts)), NONE
    if "imu" in rates:
        yield "IMU rate", _shown(rates["imu"], ".1f", "Hz"), _shown(getattr(platform.imu, "rate", None), "g", "Hz")
    if (gyro := found.gyro_at_rest) is not None:
        noise = None if platform.imu is None else platform.noise.imu
        yield _row("gyro at rest, mean", gyro.mean, getattr(noise, "gyro_bias", None), ".5f", "rad/s")
        yield _row("gyro at rest, noise", gyro.deviation, getattr(noise, "gyro_noise", None), ".5f", "rad/s")


def _lidar(found: LidarReport, rate: float | None, platform: Platform) -> Iterator[Row]:
    spec, at_rest = platform.lidar, found.noise_at_rest
    noise = platform.noise.lidar if spec.rate is not None else None  # one that gives no rate gives no noise either
    deviation, expected, at = None, None, "at rest"
    if at_rest is not None:
        deviation, at = at_rest.deviation, f"at {at_rest.at_range:.2f} m, at rest"
        if noise is not None:
            expected = noise.range_noise + noise.range_noise_per_metre * at_rest.at_range
    step, beams = spec.angle_increment, -(-found.beams // found.interlace)
    interlaced = f"{beams} of {found.beams}" if found.interlace > 1 else str(beams)
    yield "lidar beams", interlaced, _shown(spec.beams, "")
    yield _row("first beam", found.angle_min, spec.angle_min, ".4g", "deg", 180 / pi)
    yield _row("between beams", found.angle_increment, step, ".4g", "deg", 180 / pi)
    yield "turns", found.turns, NONE if step is None else "clockwise" if step < 0 else "counterclockwise"
    yield "scan rate", _shown(rate, ".2f", "Hz"), _shown(spec.rate, "g", "Hz")
    yield _row("shortest limit", found.range_min, spec.range_min, "g", "m")
    yield _row("longest limit", found.range_max, spec.range_max, "g", "m")
    yield _row("nearest endpoint", found.nearest, None, ".3f", "m")
    yield _row("farthest endpoint", found.farthest, None, ".3f", "m")
    yield _row("range resolution", found.resolution, getattr(noise, "resolution", None), ".3g", "mm", 1000)
    yield _row(f"range noise {at}", deviation, expected, ".3g", "mm", 1000)
    yield _row("dropouts", found.invalid, getattr(noise, "dropout", None), ".2f", "%", 100)
    yield _row("no return", found.no_return, None, ".2f", "%", 100)


def _row(name: str, measured: float | None, stated: float | None, form: str, unit: str, factor: float = 1) -> Row:
    return name, _shown(measured, form, unit, factor), _shown(stated, form, unit, factor)


def _shown(value: float | None, form: str, unit: str = "", factor: float = 1) -> str:
    return NONE if value is None else f"{factor * value:{form}} {unit}".rstrip()


@options.with_options(part=options.RecordingOptions)
def convert(
    path: Annotated[Path, arg("A recording or a trajectory of any format.", "IN")],
    out: Annotated[Path, arg("What is written; it must not exist.", "OUT")],
    to: Annotated[str | None, opt("Format, if OUT's ending does not say it: ucsd, rosbag2, ...", "FORMAT")] = None,
    force: Annotated[bool, flag("--force", "Replace an existing OUT, whole, at the end.")] = False,
    as_json: options.Json = False,
    *,
    part: options.RecordingOptions,
) -> None:
    """Write a recording or trajectory in another format.

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
    from moteslam.robot import formats, trajectories
    from moteslam.robot.values import counted

    name, problem, truth = None, "", None
    try:
        name = trajectories.format_to_write(out, to)
    except (ConfigError, OutputError) as error:
        problem = error.problem
    found: dict[str, Any] = {"out": str(out), "format": name}
    if name is not None or trajectories.is_trajectory(path):
        if part.given:
            raise ConfigError("of a recording, expected none for a trajectory", field=f"--{next(iter(part.given))}")
        if name is None:
            raise ConfigError(f"{path} is a trajectory: {problem}", field="--to")
        with staged_file(out, force=force, keep=path) as file:
            trajectory, issues = _read(path)
            trajectories.write_trajectory(file, trajectory, name)
        found |= {"poses": len(trajectory), "distance_m": trajectory.length}
        line = f"{literal(path.name)}: {counted(len(trajectory), 'pose')}, {trajectory.length:.1f} m"
    else:
        with options.named("--to"):
            found["format"], known = formats.format_to_write(out, to)
        assert known.write is not None
        with (result_folder if known.is_folder else staged_file)(out, force=force, keep=path) as place:
            recording = part.open(path)
            issues = (*recording.warnings, *known.write(place, recording))
        truth, streams = truth_file(path), recording.stamps().items()
        readings = {stream: len(stamps) for stream, stamps in streams if len(stamps)}
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
