"""One SLAM run as the command line does it, over a recording or over the messages of another program on stdin."""

import json
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext, suppress
from datetime import UTC, datetime
from functools import partial
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.interrupt import input_ended, until_interrupt
from moteslam.eval.cli.options import SlamOptions, named
from moteslam.eval.cli.text import note, progress_bar, say, warn
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE, Evidence
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.metrics.residuals import unfit_scans
from moteslam.eval.report.maps import keep_floor, keep_map
from moteslam.eval.results import read_building, write_result_bag, write_results
from moteslam.eval.run_tables import loop_counts
from moteslam.eval.scores import Figures, doubted, number, placed_in_map
from moteslam.eval.tables import Column, aligned, length, literal, rows_of
from moteslam.files import result_folder
from moteslam.kernels import runtime
from moteslam.robot import se2
from moteslam.robot.platform import Platform
from moteslam.robot.platforms import load_platform, platform_of, read_platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, counted, shortened
from moteslam.slam.config import SlamConfig
from moteslam.slam.estimate import Estimate, with_texture
from moteslam.slam.mapping.config import LOST_DISTANCE
from moteslam.slam.online import OnlineSlam
from moteslam.slam.scan_records import Update
from moteslam.slam.sessions import expect_graph, go_on
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper, can_map

SCORES = (
    Column("laid on the reference, rigidly", "title"),
    Column("ATE RMSE", "ate", "number", "m"),
    *(Column(name, f"ate_{name}", "number", "m", like="ate") for name in ("median", "max")),
    Column("RPE over 1 m", "rpe_1m", "number", "m", like="ate"),
    Column("heading RMSE", "heading", "number", "deg"),
)
STDIN = "stdin"
LONGEST = 4_000_000  # No line is longer [bytes]
SHOWN = 10
"""Of the lines that are left out so many are told, each in a line; then how many there were."""
KEYS = {"odometry": {"stamp", "pose", "counts"}, "imu": {"stamp", "yaw_rate"}, "scan": {"stamp", "ranges", "odometry"}}
"""What a message of each type may have."""
NEEDED = {"imu": "yaw_rate", "scan": "ranges"}
TRACKS = {"dead reckoning": DEAD_RECKONING, "SLAM (online)": ONLINE, "SLAM (final)": FINAL}


def run_into(
    folder: Path,
    recording: Recording,
    config: SlamConfig,
    options: SlamOptions,
    *,
    truth: Trajectory | None = None,
    true_map: Raster | None = None,
    relations: Relations | None = None,
    about: dict[str, Any] | None = None,
    issues: tuple[Issue, ...] = (),
    onto: Path | None = None,
) -> Figures:
    """Run SLAM over a recording and fill a result folder, which exists; what is printed of it.

    It is scored with the truth, and its map with the true one, trinary and in the frame of the truth. ``about`` goes
    into ``run.json``; ``issues`` were found before the run, those of the recording and of SLAM follow. ``onto`` is the
    result folder of the sessions before.
    """
    building = None
    if onto is not None:
        with named(**{"backend.method": "--onto"}):
            expect_graph(config)
        building = read_building(onto)
    began, clock = datetime.now(UTC), time.perf_counter()
    device = runtime.init(options.arch, options.threads)
    session = OnlineSlam.over(recording, config, seed=options.seed)
    issues = (*issues, *recording.warnings)
    warn(issues)  # a run that they make useless is long
    snapshots: list[tuple[int, Raster]] = []
    with progress_bar("SLAM", len(session), "scans") as progress:
        for update in session:
            if not options.no_figures:
                keep_map(snapshots, session, update)
            progress(update.index + 1)
    with progress_bar("final path and map", 1.0):
        estimate = session.estimate()
    del session  # the filter's maps and the graph take memory that figures need
    if building is not None:
        with progress_bar("place among the sessions before", 1.0):
            estimate = go_on(estimate, building)
    seconds = time.perf_counter() - clock
    estimate, stages = _coloured(estimate, recording)
    final, driven = estimate.trajectory_final, estimate.dead_reckoning
    # a path without a back end may zigzag by as much
    unfit = unfit_scans(recording, final, driven) if config.backend.method != "none" else ()
    noticed = [*estimate.warnings, *unfit]
    noticed += [Issue(**one) for one in doubted(Evidence({FINAL: final}, truth=truth, relations=relations))]
    placed = placed_in_map(estimate.diagnostics["state"], config.method)
    if truth is not None and config.method == "known_map" and placed.any():
        noticed += about_frame(final, truth, Path(getattr(config, "known_map", "")))
    warn(noticed)
    issues = (*issues, *noticed)
    found = write_results(
        folder,
        estimate,
        truth,
        recording=recording,
        true_map=true_map,
        relations=relations,
        snapshots=snapshots,
        stages=stages,
        figures=not options.no_figures,
        run={
            "platform": recording.platform.name,
            **(about or {}),
            "warnings": [issue.as_dict() for issue in issues],
            "command": ["moteslam", *sys.argv[1:]],
            "started": began.isoformat(timespec="seconds"),
            "slam_seconds": seconds,
            "arch": device.arch,
            "threads": device.threads,
        },
    )
    if options.mcap:
        write_result_bag(folder / "result.mcap", estimate, recording)
    return described(estimate, found, issues)


def about_frame(path: Trajectory, truth: Trajectory, known_map: Path) -> Iterator[Issue]:
    """Where a known map does not lie in the frame of the truth: scores of a path that is laid on it do not show it."""
    with suppress(InputError):
        ate = absolute_trajectory_error(path, truth)
        there = se2.compose(se2.inverse(ate.transform), ate.aligned)
        off, turned = (float(np.hypot(*(ate.aligned - there)[:, :2].T).mean()), abs(np.rad2deg(ate.transform[2])))
        if off > LOST_DISTANCE:
            text = f"scores are of the path laid on the truth, which moves it by {off:.1f} m and {turned:.0f} degrees: "
            frame = "the map of a result has a frame of its own, in which places are not scored"
            drawn = (known_map.parent / "run.json").exists()
            text += frame if drawn else f"it was found at a wrong place, or {frame}"
            yield Issue("map-frame", text)


def described(estimate: Estimate, figures: Figures, issues: tuple[Issue, ...] = ()) -> Figures:
    """The figures of ``metrics.json``, and what else is printed of a run."""
    return {
        "recording": estimate.name,
        "seed": estimate.seed,
        "first_stamp": float(estimate.trajectory.stamps[0]),
        "most_particles": int(estimate.diagnostics["particles"].max()),
        "filter_and_back_end_seconds": estimate.seconds,
        "sessions": 1 if estimate.building is None else len(estimate.building.sessions),
        "loop_candidates": loop_counts(estimate.loops),
        "session_loops": 0 if estimate.building is None else int(estimate.building.between.sum()),
        "warnings": [issue.as_dict() for issue in issues],
        **figures,
    }


def _coloured(estimate: Estimate, recording: Recording) -> tuple[Estimate, list[tuple[float, TextureMap]]]:
    """The estimate with the coloured floor, if the recording has images, and the floor at stages of the run."""
    if not (estimate.config.texture.enabled and can_map(recording)):
        return estimate, []
    stages: list[tuple[float, TextureMap]] = []
    span = estimate.trajectory_final.stamps[[0, -1]]
    with progress_bar("floor", 1.0) as progress:

        def watch(stamp: float, mapper: TextureMapper) -> None:
            keep_floor(stages, stamp, mapper, span)
            progress(min(max((stamp - span[0]) / max(np.ptp(span), 1e-9), 0.0), 1.0))

        estimate = with_texture(estimate, recording, watch=watch)
    return estimate, stages if estimate.texture is not None else []


def run_lines(found: Figures, name: str) -> Iterator[str]:
    """What was driven, how many scans and particles, where the robot was lost, and the scores."""
    particles, lost = counted(found["most_particles"], "particle"), found["localisation"]
    if found["mean_particles"] < found["most_particles"]:
        particles = f"{found['mean_particles']:.0f} of {particles} in the mean"
    pace = 1000 * found["filter_and_back_end_seconds"] / found["scans"]
    scans = f"{counted(found['scans'], 'scan')}, {particles}, {pace:.1f} ms a scan"
    by = "" if found["distance_by"] == "truth" else f" by {found['distance_by']}"
    yield f"{literal(name)}: {found['distance_m']:.1f} m{by} in {found['duration_s']:.0f} s, {scans}"
    if found["sessions"] > 1:
        yield f"bound to one building of {found['sessions']} sessions by {counted(found['session_loops'], 'loop')}"
    counts, loops, first = lost["states"], found["loop_candidates"], lost["first_lost_stamp"]
    if counts["doubtful"] or counts["lost"]:
        since = "" if first is None else f", first after {first - found['first_stamp']:.1f} s"
        doubtful = f"doubtful at {counts['doubtful']}, lost at {counts['lost']} of {found['scans']} scans"
        yield f"{doubtful}{since}: diagnostics.csv"
    if loops["candidates"]:
        yield f"{counted(loops['accepted'], 'loop')} accepted of {counted(loops['candidates'], 'candidate')}: loops.csv"
    if number(found, "final.ate") is not None:
        yield from score_lines(found)
    if (missed := number(found, "final.relations")) is not None:
        turn = number(found, "final.relations_rotation") or 0.0
        counts = found["metrics"]["final.relations"]
        which = f"{counts['used']} of {counts['total']} relations"
        yield f"SLAM (final) against {which}: off by {length(missed)} and {turn:.3g} deg in the mean"
    yield f"result in {literal(found['out'])}"


def score_lines(figures: Figures) -> Iterator[str]:
    """The absolute error, and the relative error over 1 m, which is drift a metre; then the scores of loops."""
    found = {of: figures["metrics"].get(f"{of}.ate", {}).get("count") for of in TRACKS.values()}
    fewer = found[ONLINE] is not None and found[ONLINE] < (found[FINAL] or 0)  # not lost, in a known map
    rows: list[dict[str, Any]] = [
        {"title": f"{title}, {found[of]} of {found[FINAL]} scans" if fewer and of == ONLINE else title}
        | {one.place: number(figures, f"{of}.{one.place}") for one in SCORES[1:]}
        for title, of in TRACKS.items()
    ]
    yield aligned(rows_of(SCORES, rows))
    for name in ("precision", "recall"):
        if (share := number(figures, f"loops_{name}")) is not None:
            counts = figures["metrics"][f"loops_{name}"]
            of = (
                f"{counts['accepted']} accepted"
                if name == "precision"
                else f"{counts['possible']} key scans back at a place"
            )
            yield f"{name} of loops {100 * share:.1f} % of {of}"


def follow(stream: BinaryIO, robot: Path | None, config: SlamConfig, out: Path | None, run: SlamOptions) -> None:
    """Take in the lines of a stream to its end, print an update a line, and fill the result folder if there is one.

    A line that cannot be used is told and left out: a robot does not stop for it.
    """
    with named("--platform"):
        platform = Platform() if robot is None else (read_platform if robot.suffix == ".toml" else load_platform)(robot)

    with nullcontext() if out is None else result_folder(out, force=run.force) as folder:
        device, began = runtime.init(run.arch, run.threads), time.perf_counter()
        slam, bad, number = None, 0, 0
        for number, line in enumerate(until_interrupt(partial(_line, stream)), start=1):
            try:
                message = _message(line)
                if (kind := message.pop("type")) == "platform":
                    if slam is not None:
                        raise InputError("after other messages, expected as the first", field="platform")
                    platform = platform_of(message, file=f"{STDIN}:{number}", base=platform)
                    continue
                slam = OnlineSlam(platform, config, run.seed, name=STDIN) if slam is None else slam
                _print(_add(slam, kind, message))
            except ConfigError as error:
                hint = ": --platform NAME, or a first line of type platform" if error.field == "platform.lidar" else ""
                raise ConfigError(error.problem + hint, file=error.file, field=error.field) from error
            except InputError as error:
                if error.file is not None:  # of all messages
                    raise
                bad += 1
                if bad <= SHOWN:
                    note(f"warning: {InputError(error.problem, file=STDIN, line=number, field=error.field)}; left out")
        if input_ended():
            note("interrupted: the input ends here, what came so far is finished; a second Ctrl-C throws it away")
        _print(None if slam is None else slam.finish())
        if slam is None or not len(slam):
            raise InputError(f"{number} lines without a scan, expected some", file=STDIN)
        estimate = slam.estimate()
        text = f"{STDIN}: {bad} of {number} lines were left out"
        issues = (*((Issue("broken-lines", text, bad),) if bad else ()), *estimate.warnings)
        warn(issues)
        if folder is None:
            return
        about: dict[str, Any] = {} if robot is None else {"platform": str(robot)}
        about |= {"warnings": [issue.as_dict() for issue in issues], "command": ["moteslam", *sys.argv[1:]]}
        about |= {"slam_seconds": time.perf_counter() - began, "arch": device.arch, "threads": device.threads}
        write_results(folder, estimate, figures=not run.no_figures, run=about)
    note(f"{len(estimate.trajectory)} scans, {estimate.trajectory_final.length:.1f} m: result in {out}")


def _line(stream: BinaryIO) -> bytes:
    line = stream.readline(LONGEST + 1)
    while len(line) > LONGEST and not line.endswith(b"\n") and (rest := stream.readline(LONGEST)):
        line = line[:LONGEST] + rest[-1:]  # the rest of it is skipped
    return line


def _message(line: bytes) -> dict[str, Any]:
    """The message of a line: an object with a known type, its keys, and a stamp."""
    try:
        message = json.loads(line)
    except (ValueError, RecursionError):
        message = None
    if not isinstance(message, dict):
        raise InputError(f"{shortened(line.decode('utf-8', 'replace').strip())}, expected an object of JSON")
    kind = message.get("type")
    if kind == "platform":
        return message
    if not isinstance(kind, str) or kind not in KEYS:
        raise InputError(f"{shortened(kind)}, expected platform, {', '.join(KEYS)}", field="type")
    if unknown := sorted(message.keys() - KEYS[kind] - {"type"}):
        raise InputError(f"unknown key, expected {', '.join(sorted(KEYS[kind]))}", field=f"{kind}.{unknown[0]}")
    stamp = message.get("stamp")
    if isinstance(stamp, bool) or not isinstance(stamp, int | float):
        raise InputError(f"{shortened(stamp)}, expected seconds", field=f"{kind}.stamp")
    if (needed := NEEDED.get(kind)) is not None and needed not in message:
        raise InputError("missing, expected numbers", field=f"{kind}.{needed}")
    return message


def _add(slam: OnlineSlam, kind: str, message: dict[str, Any]) -> Update | None:
    stamp = float(message["stamp"])
    if kind == "odometry":
        return slam.add_odometry(stamp, message.get("pose"), counts=message.get("counts"))
    if kind == "imu":
        return slam.add_imu(stamp, message["yaw_rate"])
    if isinstance(ranges := message["ranges"], list):  # JSON has no word for a number that is none
        ranges = [float("nan") if one is None else one for one in ranges]
    return slam.add_scan(ranges, stamp, odometry=message.get("odometry"))


def _print(update: Update | None) -> None:
    if update is None:
        return
    found = {"index": update.index, "stamp": update.stamp, "pose": update.pose.tolist()}
    found |= {"covariance": update.covariance.tolist(), "state": update.state.name.lower()}
    with suppress(*[BrokenPipeError] * input_ended()):  # the same Ctrl-C ended who reads our output
        say(json.dumps(found | {"updated": update.updated, "corrected": update.corrected}))
        sys.stdout.flush()
