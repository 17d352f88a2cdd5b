"""A run as the page plays it: paths, map, loops and particles in as few bytes as its pixels can show."""

import base64
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from moteslam.errors import InputError
from moteslam.eval.metrics.association import evenly
from moteslam.eval.metrics.ate import absolute_trajectory_error
from moteslam.eval.results import BUILDING, read_building
from moteslam.eval.run_tables import STATES, read_diagnostics, read_loops, read_particles
from moteslam.eval.scores import placed_in_map
from moteslam.files import read_bytes, read_yaml
from moteslam.robot.formats.map_server import MAX_IMAGE_BYTES, MAX_PIXELS, MAX_YAML_BYTES
from moteslam.robot.raster import decode_picture, picture_size
from moteslam.robot.se2 import Array, between, compose, inverse, transform_points
from moteslam.robot.trajectories.text import read_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import read_toml

SHOWN = {"accepted": 1, "overruled": 2, "contradicted": 3, "ambiguous": 4}
"""Verdicts of the loops that are drawn, by the number that stands for each."""
STEPS, MOST_STEPS, FEWEST_STEPS = 90_000, 2_000, 150  # Poses of all runs together, and of each
PICTURES, LARGEST_PICTURE = 6_000_000, 1_000_000
"""Bytes of all maps together, and of each; textures have as many."""
PARTICLES, FEWEST_PARTICLES, UPDATES = 30, 5, 150
"""Paths of particles of a run, of one of many, and at how many updates at least."""
CLOUDS, LARGEST_CLOUD = 400_000, 60_000
"""Numbers for the particles of all runs together, and of each; scans have as many."""
ENDPOINTS = 60  # Of a scan
NO_ERROR = -1.0  # Of a pose that is none


def playable(folder: Path, runs: int = 1) -> dict[str, Any]:
    """A result folder as plain values, in the frame of its map; one of so many on a page: some 10 MB for 300 of them.

    Lengths are whole millimetres (errors tenths), angles milliradians, times milliseconds from the first scan; each
    number but the first of a list is the difference from the one before. Of errors each is the largest since the last.
    """
    names = "trajectory_final", "trajectory", "dead_reckoning"
    final, online, odometry = (read_tum(folder / f"{name}.tum") for name in names)
    for name, other in (("trajectory", online), ("dead_reckoning", odometry)):
        if len(other) != len(final):
            problem = f"{len(other)} poses, expected {len(final)} as in trajectory_final.tum"
            raise InputError(problem, file=folder / f"{name}.tum")
    most, numbers = int(np.clip(STEPS // runs, FEWEST_STEPS, MOST_STEPS)), min(LARGEST_CLOUD, CLOUDS // runs)
    steps = evenly(np.arange(len(final)), most)
    stamps = final.stamps[steps]
    start = float(stamps[0])
    found: dict[str, Any] = {
        "t": _deltas(1e3 * (stamps - start)),
        "final": _path(final.poses[steps]),
        "online": _path(online.at(stamps).poses),
        "odometry": _path(compose(final.poses[0], between(odometry.poses[0], odometry.at(stamps).poses))),
    }
    diagnostics = read_diagnostics(folder / "diagnostics.csv")
    known = len(diagnostics.stamps) == len(final)
    states = diagnostics.values["state"] if known else np.zeros(len(final))
    placed = placed_in_map(states, read_toml(folder / "config.toml", "a config.toml").get("method", ""))
    if (folder / "truth.tum").is_file() and placed.any():
        truth = read_tum(folder / "truth.tum")
        ate = absolute_trajectory_error(final, truth)
        there = compose(inverse(ate.transform), ate.reference)
        found["truth"] = _path(Trajectory(ate.stamps, there).at(stamps).poses)
        paths = {"final": final, "online": online if placed.all() else online.take(placed), "odometry": odometry}
        errors = {name: _errors(trajectory, truth, stamps) for name, trajectory in paths.items()}
        errors["online"][~placed[steps]] = NO_ERROR
        found["errors"] = {name: _deltas(each) for name, each in errors.items()}
    if known:
        found["state"] = np.maximum.reduceat(diagnostics.values["state"], steps).astype(int).tolist()
        found["effective"] = [round(value, 1) for value in diagnostics.values["n_eff"][steps].tolist()]
    found["states"] = list(STATES)
    if (folder / "loops.csv").is_file():
        rows = []
        for loop in read_loops(folder / "loops.csv"):
            if loop.verdict not in SHOWN or max(loop.earlier, loop.later) >= len(final):
                continue
            ends = np.rint(1e3 * final.poses[[loop.earlier, loop.later], :2]).astype(int)
            time = round(1e3 * (float(final.stamps[loop.later]) - start))
            rows.append([time, *ends.ravel().tolist(), SHOWN[loop.verdict]])
        found["loops"] = sorted(rows)
    if (folder / "particles.npz").is_file():
        found["particles"] = _particles(folder / "particles.npz", start, most, numbers)
    if (folder / BUILDING).is_file():
        found["scans"] = _scans(folder, final, start, numbers)
    for name in ("map", "texture"):
        if (folder / f"{name}.yaml").is_file() and (folder / f"{name}.png").is_file():
            found[name] = _picture(folder, name, min(LARGEST_PICTURE, PICTURES // runs))
    return found


def _errors(trajectory: Trajectory, truth: Trajectory, stamps: Array) -> Array:
    """The largest error [0.1 mm] up to each stamp, from the one before on."""
    ate = absolute_trajectory_error(trajectory, truth)
    ends = np.searchsorted(ate.stamps, stamps, side="right")
    known = np.flatnonzero(np.diff(ends, prepend=0))  # steps with errors; others get what lies between
    largest = np.maximum.reduceat(ate.errors[: ends[-1]], np.append(0, ends)[known])
    return np.asarray(1e4 * np.interp(np.arange(len(stamps)), known, largest))


def _particles(file: Path, start: float, steps: int, numbers: int) -> dict[str, Any]:
    """Times of updates, and of some paths x and y at these."""
    stamps, paths = read_particles(file)
    most = int(np.clip(numbers // (2 * UPDATES), FEWEST_PARTICLES, PARTICLES))
    paths = paths[evenly(np.arange(len(paths)), most)]
    updates = evenly(np.arange(len(stamps)), max(2, min(steps, numbers // (2 * len(paths)))))
    return {
        "t": _deltas(1e3 * (stamps[updates] - start)),
        "paths": [[_deltas(1e3 * path[updates, k]) for k in (0, 1)] for path in paths],
    }


def _scans(folder: Path, final: Trajectory, start: float, numbers: int) -> dict[str, Any]:
    """Times of some key scans, and the places [cm] of some endpoints of each."""
    session = read_building(folder).sessions[-1]
    if len(session.stamps) != len(final):
        raise InputError(f"{len(session.stamps)} scans, expected {len(final)}", file=folder / BUILDING, field="stamps")
    keys = evenly(np.arange(len(session)), max(2, numbers // (2 * ENDPOINTS)))
    nodes, rows = session.nodes[keys], [slice(b, b + n) for b, n in zip(session.begins, session.counts, strict=True)]
    seen = [session.points[rows[key]][evenly(np.arange(session.counts[key]), ENDPOINTS)] for key in keys]
    places = [transform_points(pose, points) for pose, points in zip(final.poses[nodes], seen, strict=True)]
    return {
        "t": _deltas(1e3 * (final.stamps[nodes] - start)),
        "places": [[_deltas(1e2 * each[:, k]) for k in (0, 1)] for each in places],
    }


def _picture(folder: Path, name: str, most: int) -> dict[str, Any]:
    """A map or texture as a picture of at most ``most`` bytes, coarser if need be, and where it lies."""
    file, about_file = folder / f"{name}.png", folder / f"{name}.yaml"
    data = read_bytes(file, "a picture", limit=MAX_IMAGE_BYTES)
    width, height = picture_size(data) or (0, 0)
    image = decode_picture(data, cv2.IMREAD_UNCHANGED) if 0 < width * height <= MAX_PIXELS else None
    if image is None:
        raise InputError(f"no picture of at most {MAX_PIXELS} pixels, expected a PNG", file=file)
    try:
        about = read_yaml(about_file, "a map's .yaml", limit=MAX_YAML_BYTES)
        cell = float(about["resolution"])
        x, y, yaw = (float(value) for value in about["origin"])
    except (TypeError, KeyError, ValueError, OverflowError) as error:
        raise InputError("expected resolution and origin [x, y, yaw]", file=about_file) from error
    place = {"x": x, "y": y, "yaw": yaw, "width": image.shape[1] * cell, "height": image.shape[0] * cell}
    while True:
        suffix, options = (".webp", [cv2.IMWRITE_WEBP_QUALITY, 80]) if name == "texture" else (".png", [])
        _, encoded = cv2.imencode(suffix, image, options)
        if len(encoded) <= most or min(image.shape[:2]) < 64:
            break
        size = (image.shape[1] // 2, image.shape[0] // 2)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
    source = f"data:image/{suffix[1:]};base64,{base64.b64encode(encoded.tobytes()).decode()}"
    return {**{key: round(value, 4) for key, value in place.items()}, "source": source}


def _path(poses: Array) -> list[list[int]]:
    return [_deltas(1e3 * poses[:, 0]), _deltas(1e3 * poses[:, 1]), _deltas(1e3 * np.unwrap(poses[:, 2]))]


def _deltas(values: Array) -> list[int]:
    """Rounded values as the first one and the differences from each to the next."""
    whole = np.rint(np.asarray(values, np.float64)).astype(np.int64)
    return [int(value) for value in np.diff(whole, prepend=0)]
