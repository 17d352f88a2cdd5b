"""The result folder of a run: trajectories, map, figures, scores, and all that is needed to run it again."""

import gc
import heapq
import json
import os
import platform
import re
import sqlite3
import sys
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import File, InputError, OutputError
from moteslam.eval.metrics.evidence import DEAD_RECKONING, FINAL, ONLINE, Evidence
from moteslam.eval.metrics.relations import Relations
from moteslam.eval.report import curves, maps, particles
from moteslam.eval.run_tables import loop_counts, write_diagnostics, write_loops
from moteslam.eval.scores import Figures, evidence_of, figures_of, placed_in_map
from moteslam.files import Shape, cleared, mark, read_arrays, write_atomically
from moteslam.robot import se2
from moteslam.robot.formats import map_server
from moteslam.robot.formats.bags import write as bags
from moteslam.robot.formats.written import odometry_of
from moteslam.robot.raster import Raster, encode_png, write_map_arrays
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories.text import write_g2o, write_tum
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import expect_type, processor_count
from moteslam.slam.backend.building import Building, Session
from moteslam.slam.backend.graph.pose_graph import Edges, MeasuredChain
from moteslam.slam.estimate import Estimate
from moteslam.slam.texture.floor_map import TextureMap

PACKAGES = ("moteslam", "taichi", "numpy")  # Whose versions are recorded
GRAPH_COMMENTS = (
    "pose graph of moteslam: final poses, and the relative poses that were measured, with their information",
    "edges between consecutive ids are the chain, all others loops that were accepted",
)
"""What ``graph.g2o`` begins with."""
MAP = "map"  # The frame of the result bag
LINES, WIDTH, GREEN = 5, 0.03, {"g": 0.6, "a": 1.0}
"""The markers of loops: ``LINE_LIST``, how wide [m], and their colour."""
BUILDING = "sessions.npz"  # What later sessions are bound to
BUILDING_VERSION = 1
WHOLE = ("sizes", "scans", "nodes", "counts", "drawn", "points", "first", "second", "doubted")
CHAIN, LOOPS = MeasuredChain._fields, ("first", "second", "relative", "information")
EACH = ("stamps", "path", "nodes", "counts", "drawn")
PACKED = {"path": np.float32, "drawn": np.int8, "doubted": np.int8}
MOST = 32767
"""Of the steps that endpoints are written in, which are a millimetre or more: a lidar of 32 m."""
SHAPES: dict[str, Shape] = {
    **{"sizes": ("sessions",), "scans": ("sessions",), "origins": ("sessions", 2), "stamps": ("s",), "path": ("s", 3)},
    **dict.fromkeys(("nodes", "counts", "drawn", "doubted"), ("n",)),
    **dict.fromkeys(("steps", "prior_steps"), ("n", 3)),
    **dict.fromkeys(("covariance", "prior_covariance"), ("n", 3, 3)),
    **{"points": ("p", 2), "resolution": (), "first": ("loops*",), "second": ("loops*",)},
    **{"relative": ("loops*", 3), "information": ("loops*", 3, 3)},
}


def write_results(
    folder: File,
    estimate: Estimate,
    truth: Trajectory | None = None,
    *,
    recording: Recording | None = None,
    true_map: Raster | None = None,
    relations: Relations | None = None,
    snapshots: maps.Snapshots = (),
    stages: maps.Stages = (),
    figures: bool = True,
    run: Mapping[str, Any] | None = None,
) -> Figures:
    """Fill a result folder (its files: ``docs/reference/formats.md``); what ``metrics.json`` holds.

    Args:
        folder: made if need be; the results of another run in it are removed, and files of these names replaced.
        truth: what to score it with, on the clock of the recording; it is written too.
        recording: whose scans are drawn along dead reckoning, and show which loops are possible and which walls seen.
        true_map: trinary, in the frame of the truth, to score the map with.
        relations: hand-checked ones on the same clock, to score all trajectories with.
        snapshots, stages: of the map and of the coloured floor over time, for the figures that show them.
        run: more about the run for ``run.json``: the command, threads, times.
    """
    expect_type(estimate, Estimate, "estimate", "run_slam(recording) makes one")
    evidence = evidence_of(estimate, truth, recording=recording, true_map=true_map, relations=relations)
    scores = figures_of(estimate, evidence)
    others = cleared(folder := Path(folder), "metrics.json")
    tracks = {"trajectory": estimate.trajectory, "trajectory_final": estimate.trajectory_final}
    tracks |= {"dead_reckoning": estimate.dead_reckoning} | ({} if truth is None else {"truth": truth})
    for name, path in tracks.items():
        write_tum(folder / f"{name}.tum", path)
    write_diagnostics(folder / "diagnostics.csv", estimate)
    write_map_files(folder, estimate.map, estimate.texture)
    if len(estimate.particle_stamps):
        paths, spread = (one.astype(np.float32) for one in (estimate.particle_paths, estimate.particle_spread))
        arrays: dict[str, Any] = {"stamps": estimate.particle_stamps, "paths": paths, "spread": spread}
        write_atomically(folder / "particles.npz", lambda file: np.savez_compressed(file, **arrays))
    if evidence.loops is not None:
        write_loops(folder / "loops.csv", estimate.loops)
    if estimate.building is not None:
        write_g2o(folder / "graph.g2o", estimate.building.graph, comments=GRAPH_COMMENTS)
        write_building(folder / BUILDING, estimate.building)
        if len(sessions := estimate.building.sessions) > 1:
            for number, session in enumerate(sessions, start=1):
                write_tum(folder / f"session_{number}.tum", session.trajectory)
    write_json(folder / "metrics.json", scores)
    write_atomically(folder / "config.toml", estimate.config.to_toml())
    if figures:
        draw_figures(folder, estimate, evidence, snapshots=snapshots, stages=stages)
    issues = (*(() if recording is None else recording.warnings), *estimate.warnings)
    about = {
        "recording": estimate.name,
        "seed": estimate.seed,
        "filter_and_back_end_seconds": estimate.seconds,
        "warnings": [issue.as_dict() for issue in issues],
        **({} if evidence.loops is None else {"loops": loop_counts(estimate.loops)}),
    }
    versions = {"python": platform.python_version(), **estimate.versions}
    write_json(folder / "run.json", {**about, **(run or {}), "versions": versions, "hardware": hardware()})
    mark(folder, others)
    return scores


def write_map_files(folder: Path, occupancy: Raster, texture: TextureMap | None = None) -> None:
    """Write a map, and the coloured floor, as pictures, as map_server and nav2 read them (trinary), and as arrays."""
    write_atomically(folder / "map.png", encode_png(map_server.map_image(occupancy.values)))
    map_server.write_map(folder / "map.pgm", replace(occupancy, values=map_server.trinary(occupancy.values)))
    write_map_arrays(folder / "map.npz", {"log_odds": occupancy})
    if texture is not None:
        floor = replace(texture, values=maps.with_opacity(texture))
        map_server.write_picture(folder / "texture.png", floor, {"frames": texture.frames})
        arrays = {"colours": texture, "points": replace(texture, values=texture.points)}
        write_map_arrays(folder / "texture.npz", arrays)


def draw_figures(
    folder: Path, estimate: Estimate, run: Evidence, *, snapshots: maps.Snapshots, stages: maps.Stages
) -> None:
    """Draw the figures of a run into a folder, with what is known of it."""

    def drawn(draw: Callable[..., None], name: str, text: str, *given: Any, **more: Any) -> None:
        draw(folder / f"{name}.png", *given, title=f"{estimate.name}: {text}", **more)
        gc.collect()  # artists refer to each other: those of large maps would pile up

    online, final, odometry = estimate.trajectory, estimate.trajectory_final, estimate.dead_reckoning
    truth, diagnostics = run.truth, estimate.diagnostics
    text = f"the map and the final path, the others {'from one start' if truth is None else 'laid on it, rigidly'}"
    paths = {"slam": final, "dead_reckoning": odometry, "truth": truth}
    drawn(maps.draw_trajectories, "trajectories", text, estimate.map, **paths)
    if snapshots:
        placed = placed_in_map(diagnostics["state"], estimate.config.method)
        text, known = "trajectory and map over time", {"trajectory": online, "placed": placed}
        drawn(maps.draw_over_time, "over_time", text, snapshots, **known)
    if stages:
        text, given = "map and coloured floor over time", (stages, estimate.map)
        drawn(maps.draw_texture_over_time, "texture_over_time", text, *given, trajectory=final)
    known = {"recording": run.recording, "truth": truth}
    drawn(maps.draw_dead_reckoning, "dead_reckoning", "dead reckoning", odometry, **known)
    if estimate.loops:
        drawn(maps.draw_loops, "loops", "loops on the map", estimate.map, estimate.loops, trajectory=final)
    if len(estimate.particle_stamps):
        drawn(particles.draw_particles, "particles", "particles", particles.Cloud.of(estimate))
        updated = diagnostics["updated"] > 0
        n_eff, resampled, count = (diagnostics[name][updated] for name in ("n_eff", "resampled", "particles"))
        text, values = "effective number of particles", (online.stamps[updated], n_eff, resampled)
        share = getattr(estimate.config, "resample_below", 0.0)
        drawn(curves.draw_effective_particles, "effective_particles", text, *values, particles=count, below=share)
    if truth is not None:
        names = {"slam": ONLINE, "final": FINAL, "dead_reckoning": DEAD_RECKONING}
        errors = {name: run.track(of).ate for name, of in names.items()}
        drawn(curves.draw_error, "error", "error over time, after alignment", **errors)


def write_json(path: Path, value: Mapping[str, Any]) -> None:
    """Write JSON that any reader takes."""
    write_atomically(path, json.dumps(value, indent=2, allow_nan=False) + "\n")


def environment() -> dict[str, dict[str, str]]:
    """Versions and hardware of this computer, as text by name."""
    versions = {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}}
    return {"versions": versions, "hardware": {name: str(value) for name, value in hardware().items()}}


def hardware() -> dict[str, Any]:
    """What this runs on: processor, cores that may be used, memory [GiB], system."""
    memory = None
    if sys.platform != "win32":
        memory = round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
    try:
        cpu = re.search(r"^model name\s*: (.+)$", Path("/proc/cpuinfo").read_text(encoding="utf-8"), re.MULTILINE)
    except OSError:
        cpu = None
    return {
        "cpu": cpu[1].strip() if cpu else platform.processor() or platform.machine(),
        "cores": processor_count(),
        "memory_gib": memory,
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }


def write_result_bag(path: Path, estimate: Estimate, recording: Recording) -> None:
    """Write the recording's messages, ``/map``, ``/loops`` and the three paths below ``/path/``: MCAP, for viewers.

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
    cells = map_server.trinary(raster.values).ravel()
    cells[cells == map_server.OCCUPIED] = map_server.OCCUPIED_PERCENT
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


def write_building(path: Path, building: Building) -> None:
    """Write it, compressed.

    Of the chain's arrays the first row of each session is no step. Endpoints are whole numbers of ``resolution``, each
    less the one before, modulo 2^16: two bytes that pack well.
    """
    sessions, loops = building.sessions, building.loops
    points = np.concatenate([one.points for one in sessions])
    resolution = max(0.001, float(np.abs(points).max(initial=0.0)) / MOST)
    whole = np.rint(points / resolution).astype(np.int16)
    chains = [one.chain._asdict() for one in sessions]
    arrays: dict[str, Any] = {
        "version": np.int64(BUILDING_VERSION),
        "sizes": np.array([len(one) for one in sessions]),
        "scans": np.array([len(one.stamps) for one in sessions]),
        "origins": np.array([one.origin for one in sessions]),
        **{name: np.concatenate([getattr(one, name) for one in sessions]) for name in EACH},
        "points": np.diff(whole, axis=0, prepend=np.zeros((1, 2), np.int16)),
        "resolution": np.float64(resolution),
        **{name: getattr(loops, name) for name in LOOPS},
        **{name: np.concatenate([one[name][[0, *range(len(one[name]))]] for one in chains]) for name in CHAIN},
    }
    arrays |= {name: arrays[name].astype(kind) for name, kind in PACKED.items()}
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def read_building(folder: Path) -> Building:
    """Read that of a result folder; ``InputError``: there is none, of another version, or broken."""
    path = folder / BUILDING
    if not path.is_file():
        expected = "expected a result folder with key scans, as moteslam replay writes it by default"
        problem = f"no {BUILDING} (paper and localize write none)" if folder.exists() else "not found"
        raise InputError(f"{problem}, {expected}", file=folder)
    version = read_arrays(path, {"version": ()})["version"].item()
    if version != BUILDING_VERSION:
        raise InputError(f"{version}, expected {BUILDING_VERSION}: run the recording again", file=path, field="version")
    found = read_arrays(path, SHAPES)
    for name, array in found.items():
        if not np.isfinite(array).all() or (name in WHOLE and array.dtype.kind != "i"):
            expected = "whole" if name in WHOLE else "finite"
            raise InputError(f"{array.dtype}, expected {expected} numbers", file=path, field=name)
    for name, holds in _rules(found):
        if not holds:
            raise InputError("contradicts the other arrays, or no such value can be", file=path, field=name)
    resolution = np.float32(found["resolution"].item())
    points = np.cumsum(found["points"], axis=0, dtype=np.int16) * resolution
    sizes, scans = (np.cumsum(found[name])[:-1] for name in ("sizes", "scans"))
    split = {name: np.split(found[name], sizes) for name in ("nodes", "counts", "drawn", *CHAIN)}
    split |= {name: np.split(found[name].astype(np.float64), scans) for name in ("stamps", "path")}
    split["points"] = np.split(points, np.cumsum([counts.sum() for counts in split["counts"]])[:-1])
    sessions = []
    for k, origin in enumerate(found["origins"].astype(np.float64)):
        own = {name: arrays[k] for name, arrays in split.items()}
        steps = (own[name][1:].astype(bool if name == "doubted" else np.float64) for name in CHAIN)
        arrays = {name: own[name] for name in ("stamps", "path", "nodes", "points")}
        counts, drawn = own["counts"].astype(np.int32), own["drawn"].astype(bool)
        sessions.append(Session(**arrays, chain=MeasuredChain(*steps), counts=counts, drawn=drawn, origin=origin))
    loops = {name: found[name] for name in LOOPS}
    return Building(tuple(sessions), Edges(**loops, robust=np.ones(len(found["first"]), bool)))


def _rules(found: dict[str, NDArray[Any]]) -> Iterator[tuple[str, Any]]:
    """Fields, and whether they hold what can be; each needs those before it to hold."""
    nodes, sizes, scans, first, second = (found[name] for name in ("nodes", "sizes", "scans", "first", "second"))
    yield "sizes", (sizes >= 2).all() and sizes.sum() == len(nodes)
    yield "scans", (scans >= 2).all() and scans.sum() == len(found["stamps"])
    steps = np.diff(nodes, prepend=-1)
    begins = np.cumsum(sizes) - sizes
    steps[begins] = nodes[begins] + 1
    yield "nodes", (steps > 0).all() and (nodes < np.repeat(scans, sizes)).all()
    yield "counts", (found["counts"] >= 0).all() and found["counts"].sum() == len(found["points"])
    yield "points", found["points"].dtype == np.int16
    yield "resolution", 0 < found["resolution"].item() < 1
    yield "first", (first >= 0).all()
    yield "second", ((first < second) & (second < len(nodes))).all()
    for name in ("covariance", "prior_covariance", "information"):
        yield name, (np.linalg.eigvalsh(found[name]) > 0).all()
