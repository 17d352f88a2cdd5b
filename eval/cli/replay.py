"""``moteslam demo``, ``replay`` and ``localize``: SLAM, or dead reckoning, or localisation, over what a robot saw."""

from __future__ import annotations

import json
import sys
from contextlib import suppress
from itertools import chain
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from moteslam.errors import ConfigError, InputError, in_file
from moteslam.eval.cli import options
from moteslam.eval.cli.options import RecordingOptions, SlamOptions, arg, flag, opt
from moteslam.eval.cli.text import answer, simulation_bar, warn
from moteslam.eval.tables import length, literal

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.robot.values import Issue
    from moteslam.slam.config import SlamConfig

Side = Literal["lidar", "odometry"] | None
MEND = "Mend what is certainly stated wrongly; where lidar and odometry contradict each other, this one is wrong."
Calibrate = Annotated[Side, opt(MEND, "lidar|odometry")]


@options.with_options(run=SlamOptions)
def demo(
    out: Annotated[Path, opt(options.OUT)] = Path("demo"),
    scenario: Annotated[str, opt("Scenario to drive.", "NAME")] = "corridor",
    platform: options.Robot = None,
    noise: options.NoiseClass = None,
    duration: Annotated[float | None, opt("Stop the drive after S seconds.", "S", min=12)] = None,
    *,
    run: SlamOptions,
) -> None:
    """Simulate a corridor, run SLAM, score and draw it.

    The estimate is scored against the simulator's truth, which SLAM does not see.

    \b
    Examples:
      moteslam demo
      moteslam demo --scenario loop --seed 7 --out loop
      moteslam demo --scenario office --platform turtlebot3 --noise as_recorded --out small
    """  # noqa: D301
    config = run.resolved()

    from moteslam.eval.cli.running import run_into, run_lines
    from moteslam.eval.cli.simulate import scenario_of
    from moteslam.files import result_folder
    from moteslam.kernels import runtime
    from moteslam.sim.simulate import simulate

    driven = scenario_of(scenario, run.seed, platform=platform, noise=noise, duration=duration)
    with result_folder(out, force=run.force) as folder:
        runtime.init(run.arch, run.threads)  # a device that is not there is refused before the drive
        with in_file(scenario), simulation_bar() as report:
            simulation = simulate(driven, run.seed, progress=report)
        true_map, about = simulation.true_map(config.map.cell_size), {"scenario": driven.name}
        given = (folder, simulation.recording, config, run)
        found = run_into(*given, truth=simulation.truth, true_map=true_map, about=about)
    found = {"out": str(out), **found}
    look = [] if run.no_figures else [f"look at {literal(out / 'trajectories.png')}"]
    lines = chain(run_lines(found, driven.name), look)
    answer(found, lines, as_json=run.as_json)


@options.with_options(part=RecordingOptions, run=SlamOptions)
def replay(
    path: Annotated[Path | None, arg("A log file, or a folder of arrays.", "PATH", show_default=False)] = None,
    out: Annotated[Path | None, opt(options.OUT)] = None,
    dead_reckoning: Annotated[
        bool, flag("--dead-reckoning", "Odometry alone: no lidar needed, --out optional.")
    ] = False,
    onto: Annotated[Path | None, opt("Go on with the building of this result folder.", "RESULT")] = None,
    calibrate: Calibrate = None,
    stdin: Annotated[
        bool, flag("--stdin", "Read messages (no images) from stdin as lines of JSON; --out optional.")
    ] = False,
    *,
    part: RecordingOptions,
    run: SlamOptions,
) -> None:
    """Run SLAM over a recording and fill a result folder.

    First, scans are compared with each other and with the odometry. If lidar or odometry are stated so wrongly that the
    result would move by a tenth of a metre, a warning says so. Headings that do not fit the odometry's own path are
    replaced.

    A truth.tum in the folder or beside the log scores the result, as do NAME.reference.tum and NAME.relations beside
    NAME.log, and truth_map.yaml the map. SLAM does not see them.

    \b
    Examples:
      moteslam replay robot.log.gz --out result
      moteslam replay robot.log.gz --out more --preset paper --set particles=300 --seed 7
      moteslam replay robot.bag --topics lidar=/scan_front --start 20 --end 80 --out part
      moteslam replay tomorrow.log.gz --onto result --out both
      moteslam replay ucsd --sequence 20 --dead-reckoning
      driver | moteslam replay --stdin --platform turtlebot3 --out result
      moteslam replay --preset paper --print-config > mine.toml
    """  # noqa: D301
    config = run.resolved()
    if stdin:
        others = [name for name in part.given if name != "platform"]
        if path is not None or dead_reckoning or onto is not None or calibrate is not None or others or run.mcap:
            raise typer.BadParameter("expected no recording, nor what is for one alone", param_hint="'--stdin'")
        from moteslam.eval.cli.running import follow

        follow(sys.stdin.buffer, part.platform, config, out, run)
        return
    if path is None:
        raise typer.BadParameter("missing, expected a recording", param_hint="'PATH'")
    if dead_reckoning:
        _dead_reckon(path, config, out, part, run, calibrate)
        return
    if out is None:
        raise typer.BadParameter("missing, expected a folder for the result", param_hint="'--out'")

    _run_over(path, config, out, part, run, calibrate, onto)


@options.with_options(part=RecordingOptions, run=SlamOptions)
def localize(
    path: Annotated[Path, arg("A log file, or a folder of arrays.", "PATH")],
    known: Annotated[Path, opt("A map_server .yaml file, or a result folder.", "MAP", "--map")],
    out: Annotated[Path, opt(options.OUT)],
    near: Annotated[
        tuple[float, float, float, float] | None,
        opt("Start of the robot [m, m, rad], and the standard deviation of x and y [m].", "X Y THETA SPREAD"),
    ] = None,
    calibrate: Calibrate = None,
    *,
    part: RecordingOptions,
    run: SlamOptions,
) -> None:
    """Find the robot in a known map, and track it there.

    The whole map is searched, in all headings, until one place is left. Until then, and where the scans contradict the
    map, the state is `lost`. Poses are in the frame of the map. A warning tells of a recording of another place.

    \b
    Examples:
      moteslam localize robot.log.gz --map building/map.yaml --out found
      moteslam localize tomorrow.bag --map result --near 2.0 -1.5 0.1 0.5 --out found
    """  # noqa: D301
    from moteslam.robot.formats import format_of
    from moteslam.slam.known_map.config import KnownMapConfig

    if known.suffix.lower() in (".png", ".pgm"):
        raise ConfigError(f"{known}, expected the .yaml file of this image, or a result folder", field="--map")
    file = known / "map.yaml" if known.is_dir() else known
    if file.suffix != ".yaml" or not file.exists():
        with suppress(InputError):
            format_of(known)
            problem = f"{known} is a recording, expected the .yaml file of a map, or the result folder of a run"
            raise ConfigError(problem, field="--map")
    start = [] if near is None else [f"start=[{', '.join(map(repr, near))}]"]
    with options.named(**({} if near is None else {"--set start": "--near"})):
        config = run.resolved("localize", [f"known_map={json.dumps(str(file.absolute()))}", *start])
        if not isinstance(config, KnownMapConfig):
            raise ConfigError(f'method "{config.method}", expected one that takes a known map', field="--preset")
    _run_over(path, config, out, part, run, calibrate, None)


def _run_over(
    path: Path, config: SlamConfig, out: Path, part: RecordingOptions, run: SlamOptions, side: Side, onto: Path | None
) -> None:
    from moteslam.eval.cli.running import run_into, run_lines
    from moteslam.eval.scores import relations_beside, true_map_beside, truth_beside
    from moteslam.files import result_folder
    from moteslam.slam.calibration.findings import trusting

    recording, not_as_stated = _checked(part.open(path), side)
    if side is None:
        config = config.model_copy(update={"sync": trusting(config.sync, not_as_stated)})
    truth, issues = (None, ()) if recording.lidar is None else truth_beside(path, recording.lidar.stamps)
    about = {name: value for name, value in part.given.items() if name not in ("sequence", "platform")}
    about |= {} if side is None else {"calibrate": side}
    about |= {} if onto is None else {"onto": str(onto)}
    with result_folder(out, force=run.force, keep=path) as folder:
        found = run_into(
            *(folder, recording, config, run),
            truth=truth,
            true_map=None if truth is None else true_map_beside(path),
            relations=relations_beside(path),
            about={"path": str(path), **about},
            issues=(*not_as_stated, *part.about_each_lidar(path), *issues),
            onto=onto,
        )
    found = {"out": str(out), **found}
    answer(found, run_lines(found, recording.name), as_json=run.as_json)


def _checked(recording: Recording, side: Side) -> tuple[Recording, tuple[Issue, ...]]:
    """The recording as SLAM is to take it in, and what of it is not as stated.

    Without a side to mend, only that is corrected of which it is known which side is wrong.
    """
    from moteslam.robot.values import Issue
    from moteslam.slam.calibration.checked import checked
    from moteslam.slam.calibration.findings import stamped_at_end
    from moteslam.slam.calibration.mended import NOT_MENDED, calibrated

    found, about = checked(recording)
    if found is None or about is None:
        text = "calibration: too few scans that fit each other, or no odometry that turns as they do: nothing is mended"
        unfit = () if about is None else about.moves
        told = side is None or any(issue.code == "not-calibrated" for issue in unfit)
        return recording, unfit if told else (*unfit, Issue("not-calibrated", text))
    if side is None:
        ends = dict.fromkeys(about.decided, "; corrected") | dict.fromkeys(NOT_MENDED, "")
        if not found.late:
            text = "; odometry corrected: the path has the stamps of the scans"
            if stamped_at_end(found, recording):
                text = "; scans corrected: the path has stamps that are as much earlier"
            ends |= dict.fromkeys({"clock-offset", "clock-drift"} & about.decided, text)
        moves = tuple(Issue(one.code, one.message + ends.get(one.code, "; see --calibrate")) for one in about.moves)
        return (calibrated(recording, found, None) if about.decided else recording), moves
    ends, mended = dict.fromkeys(NOT_MENDED, ""), f"; mended in the {side}'s figures"
    issues = [Issue(one.code, one.message + ends.get(one.code, mended)) for one in about.issues]
    text = "calibration: nothing differs certainly from what is stated: nothing is mended (inspect shows the figures)"
    recording = calibrated(recording, found, side)
    again, more = checked(recording) if issues else (None, None)  # one fault may hide another
    if again is not None and more is not None:
        hidden = [one for one in more.issues if one.code not in {issue.code for issue in issues}]
        recording = calibrated(recording, again, side) if hidden else recording
        issues += [Issue(one.code, one.message + ends.get(one.code, mended)) for one in hidden]
    return recording, tuple(issues) or (Issue("not-calibrated", text),)


def _dead_reckon(
    path: Path, config: SlamConfig, out: Path | None, part: RecordingOptions, run: SlamOptions, side: Side
) -> None:
    from moteslam.eval.metrics.ate import absolute_trajectory_error
    from moteslam.eval.scores import truth_beside
    from moteslam.files import result_folder, write_atomically
    from moteslam.robot.trajectories.text import write_tum
    from moteslam.slam.inputs.synchronise import dead_reckon

    recording, not_as_stated = _checked(part.open(path), side)
    trajectory = dead_reckon(recording, config.sync)
    truth, issues = truth_beside(path, trajectory.stamps)
    ate = None if truth is None else absolute_trajectory_error(trajectory, truth).rmse
    issues = (*not_as_stated, *recording.warnings, *issues)
    warn(issues)
    if out is not None:
        with result_folder(out, force=run.force, keep=path) as folder:
            write_tum(folder / "dead_reckoning.tum", trajectory)
            write_atomically(folder / "config.toml", config.to_toml())
            if not run.no_figures:
                from moteslam.eval.report.maps import draw_dead_reckoning

                file, title = folder / "dead_reckoning.png", f"{recording.name}: dead reckoning"
                draw_dead_reckoning(file, trajectory, recording=recording, truth=truth, title=title)
    x, y, theta = trajectory.poses[-1].tolist()
    duration = float(trajectory.stamps[-1] - trajectory.stamps[0])
    found: dict[str, object] = {"out": None if out is None else str(out), "recording": recording.name}
    found |= {"poses": len(trajectory), "distance_m": trajectory.length, "duration_s": duration}
    found |= {"end": {"x_m": x, "y_m": y, "heading_deg": degrees(theta)}}
    found |= {} if ate is None else {"ate_m": ate}
    found |= {"warnings": [issue.as_dict() for issue in issues]}
    lines = [
        f"{literal(recording.name)}: dead reckoning over {trajectory.length:.1f} m in {duration:.1f} s",
        f"ends at x {x:.2f} m, y {y:.2f} m, heading {degrees(theta):.1f} deg",
        *([] if ate is None else [f"ATE {length(ate)}, by the truth beside the recording"]),
        *([] if out is None else [f"result in {literal(out)}"]),
    ]
    answer(found, lines, as_json=run.as_json)
