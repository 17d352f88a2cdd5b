"""A result as an MCAP file of ROS 2 messages, for viewers: the recording, and map, paths and loops beside it."""

from __future__ import annotations

import heapq
import sqlite3
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from moteslam.errors import InputError, OutputError
from moteslam.robot import se2
from moteslam.robot.formats.bags import write as bags
from moteslam.robot.formats.map_server import OCCUPIED, OCCUPIED_PERCENT, trinary
from moteslam.robot.formats.written import odometry_of
from moteslam.robot.recording import Recording
from moteslam.slam.estimate import Estimate

MAP = "map"
LINES, WIDTH, GREEN = 5, 0.03, {"g": 0.6, "a": 1.0}
"""The markers of loops: ``LINE_LIST``, how wide [m], and their colour."""


def write_result_bag(path: Path, estimate: Estimate, recording: Recording) -> None:
    """Write ``/map``, ``/path/final``, ``online`` and ``dead_reckoning``, ``/loops``, and the recording's messages.

    The transform from ``map`` to ``odom`` (to ``base_link`` without odometry) follows the final path. Images are left
    out: ``moteslam convert`` writes them. ``InputError``: stamps that ROS does not hold.
    """
    stamps = estimate.trajectory.stamps
    if not (stamps[0] >= 0 and stamps[-1] < bags.LATEST - 1):
        raise InputError(f"stamps from {stamps[0]:g} to {stamps[-1]:g} s, expected 0 to 2^31 s", file=estimate.name)
    recording = recording.replace(rgbd=None)
    odometry = odometry_of(recording)
    frame, poses = bags.BASE, estimate.trajectory_final.poses
    if odometry[0] is not None:
        at_scans = se2.interpolate(odometry[0].stamps, odometry[0].poses, stamps)
        frame, poses = bags.ODOM, se2.compose(poses, se2.inverse(at_scans))
    placed = zip(bags.nanoseconds(stamps).tolist(), poses.tolist(), strict=True)
    moves = ((time, bags.transform(time, MAP, frame, (x, y, 0.0), bags.turned(yaw))) for time, (x, y, yaw) in placed)
    moved = (bags.Event(time, "/tf", "tf2_msgs/TFMessage", {"transforms": [one]}) for time, one in moves)
    events = heapq.merge(bags.events_of(recording, odometry, []), _drawn(estimate), moved, key=lambda event: event.time)
    try:
        bags.write_ros2(path, "mcap", events)
    except (OSError, sqlite3.Error) as error:
        raise OutputError(f"cannot be written: {getattr(error, 'strerror', None) or error}", file=path) from error


def _drawn(estimate: Estimate) -> Iterator[bags.Event]:
    """What is known of the whole run, at its first stamp."""
    time = int(bags.nanoseconds(estimate.trajectory.stamps[:1])[0])
    head, raster = bags.header(time, MAP), estimate.map
    x, y, yaw = raster.origin
    figures = {"resolution": raster.cell_size, "height": raster.shape[0], "width": raster.shape[1]}
    cells = trinary(raster.values).ravel()
    cells[cells == OCCUPIED] = OCCUPIED_PERCENT
    grid = {"header": head, "info": {**figures, "origin": _pose(x, y, yaw)}, "data": cells}
    yield bags.Event(time, "/map", "nav_msgs/OccupancyGrid", grid, latched=True)
    paths = {"final": estimate.trajectory_final, "online": estimate.trajectory}
    for name, path in {**paths, "dead_reckoning": estimate.dead_reckoning}.items():
        placed = zip(bags.nanoseconds(path.stamps).tolist(), path.poses.tolist(), strict=True)
        poses = [{"header": bags.header(at, MAP), "pose": _pose(*pose)} for at, pose in placed]
        yield bags.Event(time, f"/path/{name}", "nav_msgs/Path", {"header": head, "poses": poses}, latched=True)
    places = estimate.trajectory_final.poses
    ends = [places[scan] for loop in estimate.loops if loop.accepted for scan in (loop.earlier, loop.later)]
    points = [bags.vector(x, y, 0.0) for x, y, _ in np.reshape(ends, (-1, 3)).tolist()]
    lines: bags.Values = {"header": head, "type": LINES, "scale": {"x": WIDTH}, "pose": _pose(0.0, 0.0, 0.0)}
    lines |= {"points": points, "color": GREEN}
    yield bags.Event(time, "/loops", "visualization_msgs/Marker", lines, latched=True)


def _pose(x: float, y: float, theta: float) -> bags.Values:
    return {"position": bags.vector(x, y, 0.0), "orientation": bags.turned(theta)}
