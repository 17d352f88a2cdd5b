"""``moteslam replay --stdin``: SLAM over the messages of another program, a line of JSON each."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Iterator
from contextlib import nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO

from moteslam.errors import ConfigError, InputError
from moteslam.eval.cli.interrupt import check_interrupt
from moteslam.eval.cli.options import named
from moteslam.eval.cli.text import note, say, warn
from moteslam.robot.values import Issue, shortened

if TYPE_CHECKING:
    from moteslam.eval.cli.options import SlamOptions
    from moteslam.slam.config import SlamConfig
    from moteslam.slam.online import OnlineSlam
    from moteslam.slam.scan_records import Update

STDIN = "stdin"
LONGEST = 4_000_000  # No line is longer [bytes]
SHOWN = 10
"""Of the lines that are left out so many are told, each in a line; then how many there were."""
KEYS = {"odometry": {"stamp", "pose", "counts"}, "imu": {"stamp", "yaw_rate"}, "scan": {"stamp", "ranges", "odometry"}}
"""What a message of each type may have."""


def follow(stream: BinaryIO, robot: Path | None, config: SlamConfig, out: Path | None, run: SlamOptions) -> None:
    """Take in the lines of a stream to its end, print an update a line, and fill the result folder if there is one.

    A line that cannot be used is told and left out: a robot does not stop for it.
    """
    from moteslam.eval.results import write_results
    from moteslam.files import result_folder
    from moteslam.kernels import runtime
    from moteslam.robot.platform import Platform
    from moteslam.robot.platforms import load_platform, platform_of, read_platform
    from moteslam.slam.online import OnlineSlam

    with named("--platform"):
        platform = Platform() if robot is None else (read_platform if robot.suffix == ".toml" else load_platform)(robot)

    with nullcontext() if out is None else result_folder(out, force=run.force) as folder:
        device, began = runtime.init(run.arch, run.threads), time.perf_counter()
        slam, bad, number = None, 0, 0
        for number, line in enumerate(_lines(stream), start=1):
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


def _lines(stream: BinaryIO) -> Iterator[bytes]:
    while line := stream.readline(LONGEST + 1):
        check_interrupt()
        while len(line) > LONGEST and not line.endswith(b"\n") and (rest := stream.readline(LONGEST)):
            line = line[:LONGEST] + rest[-1:]  # the rest of it is skipped
        yield line


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
    return message


def _add(slam: OnlineSlam, kind: str, message: dict[str, Any]) -> Update | None:
    stamp, ranges = float(message["stamp"]), message.get("ranges", "none")
    if kind == "odometry":
        return slam.add_odometry(stamp, message.get("pose"), counts=message.get("counts"))
    if kind == "imu":
        return slam.add_imu(stamp, message.get("yaw_rate", "none"))
    if isinstance(ranges, list):  # JSON has no word for a number that is none
        ranges = [float("nan") if one is None else one for one in ranges]
    return slam.add_scan(ranges, stamp, odometry=message.get("odometry"))


def _print(update: Update | None) -> None:
    if update is None:
        return
    found = {"index": update.index, "stamp": update.stamp, "pose": update.pose.tolist()}
    found |= {"covariance": update.covariance.tolist(), "state": update.state.name.lower()}
    say(json.dumps(found | {"updated": update.updated, "corrected": update.corrected}))
    sys.stdout.flush()
