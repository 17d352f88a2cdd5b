"""``moteslam follow``: SLAM over a recording that is still being written, scan by scan."""

from __future__ import annotations

import json
import time
from dataclasses import asdict
from math import degrees
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from moteslam.errors import InputError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import flush, say, warn
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.eval.live import Live
    from moteslam.slam.scan_records import Update

POLL = 0.02
"""Between two looks at the file [s]."""


@options.with_options(run=options.SlamOptions)
def follow(
    path: Annotated[Path, typer.Argument(metavar="PATH", help="A CARMEN log or MCAP file that is being written.")],
    out: Annotated[Path | None, typer.Option(help="Folder for the result at the end; it must not exist.")] = None,
    idle: Annotated[float, typer.Option(metavar="S", min=0.0, help="End after this much silence.")] = 10.0,
    platform: options.PlatformFile = None,
    *,
    run: options.SlamOptions,
) -> None:
    """Run SLAM over a recording that is still being written, as it would run on the robot.

    A line a scan: its stamp, the pose, how sure it is, and the latency, from when the scan was in the file to its pose.
    A scan waits for the odometry after it. It ends after --idle seconds of silence, or with Ctrl-C; the result is
    then that of replay of the finished file.

    \b
    Examples:
      moteslam follow robot.log
      moteslam follow robot.mcap --out result --idle 60
      moteslam follow robot.log --json | my-navigation
    """  # noqa: D301
    from moteslam.robot.formats import follow_recording

    config = run.resolved()
    if run.print_config:
        options.print_config(config, as_json=run.as_json)
        return
    follower = follow_recording(path, platform=platform)

    from moteslam.eval.cli.running import Device, Started, finish_into
    from moteslam.eval.live import Live
    from moteslam.robot.result_folder import result_folder

    live = Live(follower, config, seed=run.seed)
    device = Device(run.arch, run.threads)
    if out is None:
        Started(device)
        _follow(path, live, idle, as_json=run.as_json)
    else:
        with result_folder(out, force=run.force, keep=path) as folder:
            started = Started(device)
            _follow(path, live, idle, as_json=run.as_json)
            assert live.session is not None
            about = {"path": str(path), "latency_seconds": asdict(live.latency)}
            finish_into(folder, live.session, started, figures=not run.no_figures, about=about, issues=live.issues)
    assert live.session is not None
    if out is None:
        warn((*live.session.recording.warnings, *live.issues))
    if run.as_json:
        return
    latency = live.latency
    say(
        f"{len(live.session)} scans, latency {_milliseconds(latency.median)} in the median, "
        f"{_milliseconds(latency.quantile_99)} at the 99th percentile, {_milliseconds(latency.longest)} at most"
    )
    if out is not None:
        say(f"result in {literal(out)}")


def _follow(path: Path, live: Live, idle: float, *, as_json: bool) -> None:
    """Take in scans until nothing more is written, or the user stops it.

    Raises:
        InputError: no scan was written, or the file was replaced, cut short or is broken.
    """
    from moteslam.eval.cli.interrupt import asked_to_stop

    if not as_json:
        say(f"{'stamp [s]':>17}  {'x [m]':>8}  {'y [m]':>8}  {'heading [deg]':>13}  {'state':<8}  latency [ms]")
    with asked_to_stop() as stopped:
        grew, size = time.monotonic(), _size(path)
        while not stopped() and time.monotonic() - grew < idle:
            if not live.poll():
                if (now := _size(path)) != size:  # what was written is not whole yet
                    grew, size = time.monotonic(), now
                time.sleep(POLL)
                continue
            for update, latency in live.take_in():
                _say_scan(update, latency, as_json=as_json)
                if stopped():
                    break
            grew = time.monotonic()
    try:
        for update, latency in live.finish():
            _say_scan(update, latency, as_json=as_json)
    except InputError as error:
        raise InputError(error.problem, file=error.file or path, field=error.field) from error


def _size(path: Path) -> int:
    """Bytes of the file, 0 while there is none."""
    try:
        return path.stat().st_size
    except OSError:
        return 0


def _say_scan(update: Update, latency: float, *, as_json: bool) -> None:
    x, y, theta = update.pose.tolist()
    state = update.state.name.lower()
    if as_json:
        pose = {"x_m": x, "y_m": y, "heading_deg": degrees(theta)}
        say(json.dumps({"stamp": update.stamp, **pose, "state": state, "latency_ms": 1000 * latency}))
    else:
        say(f"{update.stamp:17.6f}  {x:8.3f}  {y:8.3f}  {degrees(theta):13.2f}  {state:<8}  {1000 * latency:12.1f}")
    flush()


def _milliseconds(seconds: float) -> str:
    return f"{1000 * seconds:.1f} ms"
