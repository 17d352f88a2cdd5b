"""``sessions.npz`` of a result folder: what later sessions are bound to."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.files import Shape, read_arrays, write_atomically
from moteslam.slam.backend.building import Building, Session
from moteslam.slam.backend.graph.measured_chain import MeasuredChain
from moteslam.slam.backend.graph.pose_graph import Edges

NAME = "sessions.npz"
VERSION = 1
WHOLE = ("sizes", "scans", "nodes", "counts", "drawn", "points", "first", "second", "doubted")
CHAIN, LOOPS = MeasuredChain._fields, ("first", "second", "relative", "information")
MOST = 32767
"""Of the steps that endpoints are written in, which are a millimetre or more: a lidar of 32 m."""
SHAPES: dict[str, Shape] = {
    "sizes": ("sessions",),
    "scans": ("sessions",),
    "origins": ("sessions", 2),
    "stamps": ("s",),
    "path": ("s", 3),
    "nodes": ("n",),
    "counts": ("n",),
    "drawn": ("n",),
    "steps": ("n", 3),
    "covariance": ("n", 3, 3),
    "prior_steps": ("n", 3),
    "prior_covariance": ("n", 3, 3),
    "doubted": ("n",),
    "points": ("p", 2),
    "resolution": (),
    "first": ("loops*",),
    "second": ("loops*",),
    "relative": ("loops*", 3),
    "information": ("loops*", 3, 3),
}


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
        "version": np.int64(VERSION),
        "sizes": np.array([len(one) for one in sessions]),
        "scans": np.array([len(one.stamps) for one in sessions]),
        "origins": np.array([one.origin for one in sessions]),
        "stamps": np.concatenate([one.stamps for one in sessions]),
        "path": np.concatenate([one.path for one in sessions]).astype(np.float32),
        "nodes": np.concatenate([one.nodes for one in sessions]),
        "counts": np.concatenate([one.counts for one in sessions]),
        "drawn": np.concatenate([one.drawn for one in sessions]).astype(np.int8),
        "points": np.diff(whole, axis=0, prepend=np.zeros((1, 2), np.int16)),
        "resolution": np.float64(resolution),
        **{name: getattr(loops, name) for name in LOOPS},
        **{name: np.concatenate([one[name][[0, *range(len(one[name]))]] for one in chains]) for name in CHAIN},
    }
    arrays["doubted"] = arrays["doubted"].astype(np.int8)
    write_atomically(path, lambda file: np.savez_compressed(file, **arrays))


def read_building(folder: Path) -> Building:
    """Read that of a result folder.

    Raises:
        InputError: there is none, of another version, or broken; file and field are named.
    """
    path = folder / NAME
    version = read_arrays(path, {"version": ()})["version"].item()
    if version != VERSION:
        raise InputError(f"{version}, expected {VERSION}: run the recording again", file=path, field="version")
    found = read_arrays(path, SHAPES)
    _check(path, found)
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


def _check(path: Path, found: dict[str, NDArray[Any]]) -> None:
    """Refuse arrays that contradict each other, or mean nothing."""
    for name, array in found.items():
        if not np.isfinite(array).all():
            raise InputError("expected finite numbers", file=path, field=name)
        if name in WHOLE and array.dtype.kind != "i":
            raise InputError(f"{array.dtype}, expected whole numbers", file=path, field=name)
    for name, holds in _rules(found):
        if not holds:
            raise InputError("contradicts the other arrays, or no such value can be", file=path, field=name)


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
