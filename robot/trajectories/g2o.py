"""g2o: a pose graph in lines, a vertex or an edge each.

Source: the type SE2 of g2o (Kuemmerle et al. 2011). An information matrix is written by the rows of its upper triangle;
the error that it weighs is x, y and heading in the frame of the measured pose.

g2o has no stamps. Here a comment ``# STAMP id seconds`` gives that of a vertex; other programs pass it over.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.columns import all_lines, finite_numbers
from moteslam.robot.trajectories.text import stamps_beside
from moteslam.robot.trajectory import PoseGraph, Trajectory
from moteslam.robot.values import counted, expect_type

COUNTS = {"VERTEX_SE2": (1, 3), "EDGE_SE2": (2, 9), "# STAMP": (1, 1)}
"""How many ids and then numbers follow."""
LARGEST_ID = 2**63 - 1
"""Some programs keep a robot's letter in the upper bits of an id: of 64, one for the sign."""


def read_g2o(path: str | PathLike[str]) -> PoseGraph:
    """Read a pose graph in the plane.

    Landmarks, parameters and all else that is not a pose or an edge between poses is passed over, with a warning that
    counts it; vertices and edges in space (``SE3:QUAT``) are refused.
    """
    path = Path(path)
    found: dict[str, list[tuple[int, list[int], list[float]]]] = {tag: [] for tag in (*COUNTS, "FIX")}
    passed_over: Counter[str] = Counter()
    for number, line in all_lines(path, "a g2o pose graph"):
        words = line.split()
        tag = " ".join(words[:2]) if words[0] == "#" else words[0]
        if tag in found:
            words = line.removeprefix(tag).split()
            named, count = COUNTS.get(tag, (len(words), 0))
            numbers = finite_numbers(words[named : named + count])
            if len(words) < named or numbers is None or len(numbers) != count:
                what = f"{counted(named, 'id')} and {counted(count, 'finite number')}"
                raise InputError(f"expected {what} after {tag}", file=path, line=number)
            found[tag].append((number, [_id(word, path, number) for word in words[:named]], numbers))
        elif tag.endswith("SE3:QUAT"):
            raise InputError(f"{tag}, expected a graph in the plane: VERTEX_SE2 and EDGE_SE2", file=path, line=number)
        elif not tag.startswith("#"):
            passed_over[tag] += 1
    vertices, edges, stamps, fixed = found.values()
    if not vertices:
        raise InputError("no poses, expected g2o lines: VERTEX_SE2 id x y theta", file=path)
    vertices.sort(key=lambda vertex: vertex[1])  # stable: of equal ids the later line comes later
    ids = [id_ for _, (id_,), _ in vertices]
    index = {id_: k for k, id_ in enumerate(ids)}
    for (_, (last,), _), (number, (id_,), _) in pairwise(vertices):
        if id_ == last:
            raise InputError(f"vertex {id_} stands twice, expected it once", file=path, line=number)
    for number, some, _ in (*edges, *fixed, *stamps):
        if strange := [id_ for id_ in some if id_ not in index]:
            raise InputError(f"vertex {strange[0]} is not there, expected one of the file's", file=path, line=number)
    for number, (first, second), _ in edges:
        if first == second:
            raise InputError(f"an edge from {first} to itself, expected two vertices", file=path, line=number)
    if passed_over:
        kinds = ", ".join(f"{tag[:40]} ({count})" for tag, count in passed_over.most_common(5))
        text = f"{path}: {counted(passed_over.total(), 'line')} passed over, of no pose or edge: {kinds}"
        warnings.warn(MoteslamWarning(text), stacklevel=2)
    seconds = {id_: (second, number) for number, (id_,), (second,) in stamps}
    if seconds and (missing := [id_ for id_ in ids if id_ not in seconds]):
        raise InputError(f"vertex {missing[0]} has no stamp, expected one for all or none", file=path)
    for before, id_ in pairwise(ids) if seconds else ():
        if seconds[id_] < seconds[before]:
            problem = "stamp before that of the vertex before, expected rising"
            raise InputError(problem, file=path, line=seconds[id_][1])
    ends = np.array([[index[first], index[second]] for _, (first, second), _ in edges], np.int64).reshape(-1, 2)
    table = np.array([numbers for _, _, numbers in edges]).reshape(-1, 9)
    rows, columns = np.triu_indices(3)
    information = np.zeros((len(table), 3, 3))
    information[:, rows, columns] = information[:, columns, rows] = table[:, 3:]
    return PoseGraph(
        ids=np.array(ids, np.int64),
        poses=np.array([pose for _, _, pose in vertices]),
        first=ends[:, 0],
        second=ends[:, 1],
        relative=table[:, :3],
        information=information,
        stamps=np.array([seconds[id_][0] for id_ in ids]) if seconds else None,
        fixed=np.array([index[id_] for _, some, _ in fixed for id_ in some], np.int64),
    )


def _id(word: str, path: Path, line: int) -> int:
    if word.isascii() and word.isdecimal() and len(word) <= len(str(LARGEST_ID)) and int(word) <= LARGEST_ID:
        return int(word)
    raise InputError(f"{word[:40]!r}, expected the id of a vertex", file=path, line=line)


def write_g2o(path: str | PathLike[str], graph: PoseGraph, *, comments: Sequence[str] = ()) -> None:
    """Write a pose graph as ``VERTEX_SE2``, ``FIX`` and ``EDGE_SE2`` lines; it reads back the same, bit for bit.

    Stamps are comments ``# STAMP id seconds`` before the vertices. Before edges that are loops stands ``# loops``,
    before those of the chain ``# chain``. ``comments`` are lines to begin with.
    """
    expect_type(graph, PoseGraph, "graph")
    ids = graph.ids.tolist()
    lines = [f"# {comment}" for comment in comments]
    if graph.stamps is not None:
        lines += [f"# STAMP {id_} {stamp!r}" for id_, stamp in zip(ids, graph.stamps.tolist(), strict=True)]
    for id_, pose in zip(ids, graph.poses.tolist(), strict=True):
        lines.append(" ".join(["VERTEX_SE2", str(id_), *map(repr, pose)]))  # the fewest digits that read back the same
    lines += [f"FIX {ids[index]}" for index in graph.fixed.tolist()]
    upper = graph.information[:, *np.triu_indices(3)]
    edges = zip(graph.first.tolist(), graph.second.tolist(), graph.relative.tolist(), upper.tolist(), strict=True)
    kind = None
    for (first, second, relative, information), loop in zip(edges, graph.loops.tolist(), strict=True):
        if kind != loop:
            lines.append("# loops" if loop else "# chain")
            kind = loop
        lines.append(" ".join(["EDGE_SE2", str(ids[first]), str(ids[second]), *map(repr, relative + information)]))
    write_atomically(path, "\n".join(lines) + "\n")


def read_vertices(path: Path, graph: PoseGraph | None = None) -> Trajectory:
    """The vertices of the graph of a file in the order of their ids, at its stamps or those of `stamps_beside`."""
    graph = read_g2o(path) if graph is None else graph
    stamps, issues = stamps_beside(path, len(graph)) if graph.stamps is None else (graph.stamps, ())
    return Trajectory(stamps, graph.poses, warnings=issues)


def write_vertices(path: Path, trajectory: Trajectory) -> None:
    """Write a trajectory as a pose graph without edges, the first pose fixed; it reads back the same, bit for bit."""
    expect_type(trajectory, Trajectory, "trajectory")
    n = len(trajectory)
    graph = PoseGraph(ids=np.arange(n), poses=trajectory.poses, stamps=trajectory.stamps, fixed=np.arange(min(n, 1)))
    write_g2o(path, graph)
