"""g2o: a pose graph in lines, a vertex or an edge each.

Source: the type SE2 of g2o (Kuemmerle et al. 2011). An information matrix is written by the rows of its upper triangle;
the error that it weighs is x, y and heading in the frame of the measured pose.

g2o has no stamps. Here a comment ``# STAMP id seconds`` gives that of a vertex; other programs pass it over.
"""

from __future__ import annotations

import warnings
from collections import Counter
from collections.abc import Sequence
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.columns import all_lines, finite_numbers
from moteslam.robot.trajectories.text import TrajectoryFormat, stamps_beside
from moteslam.robot.trajectory import Array, PoseGraph, Trajectory
from moteslam.robot.values import counted, expect_type

COUNTS = {"VERTEX_SE2": (1, 3), "EDGE_SE2": (2, 9), "# STAMP": (1, 1)}
"""How many ids and then numbers follow."""
LARGEST_ID = 2**63 - 1
"""Some programs keep a robot's letter in the upper bits of an id: of 64, one for the sign."""


def read_g2o(path: str | PathLike[str]) -> PoseGraph:
    """Read a pose graph in the plane.

    Landmarks, parameters and all else that is no pose or edge between poses is passed over, with a warning that counts
    it; vertices and edges in space (``SE3:QUAT``) are refused.
    """
    path = Path(path)
    poses: dict[int, list[float]] = {}
    stamps: dict[int, tuple[int, float]] = {}  # line and seconds, by id
    named: list[tuple[int, int]] = []  # line and id, two of each edge, after those of FIX
    fixed: list[tuple[int, int]] = []
    measured: list[list[float]] = []
    passed_over: Counter[str] = Counter()
    for number, line in all_lines(path, "a g2o pose graph"):
        words = line.split()
        tag = " ".join(words[:2]) if words[0] == "#" else words[0]
        if tag in COUNTS:
            (id_, *others), numbers = _split(path, number, tag, line.removeprefix(tag).split())
            if tag == "# STAMP":
                stamps[id_] = number, numbers[0]
            elif tag == "EDGE_SE2":
                if id_ == others[0]:
                    raise InputError(f"an edge from {id_} to itself, expected two vertices", file=path, line=number)
                named += [(number, id_), (number, others[0])]
                measured.append(numbers)
            elif id_ in poses:
                raise InputError(f"vertex {id_} stands twice, expected it once", file=path, line=number)
            else:
                poses[id_] = numbers
        elif tag == "FIX":
            fixed += [(number, _id(word, path, number)) for word in words[1:]]
        elif tag.endswith("SE3:QUAT"):
            raise InputError(f"{tag}, expected a graph in the plane: VERTEX_SE2 and EDGE_SE2", file=path, line=number)
        elif not tag.startswith("#"):
            passed_over[tag] += 1
    if not poses:
        raise InputError("no poses, expected g2o lines: VERTEX_SE2 id x y theta", file=path)
    ids = sorted(poses)
    index = {id_: k for k, id_ in enumerate(ids)}
    for number, id_ in (*named, *fixed, *((number, id_) for id_, (number, _) in stamps.items())):
        if id_ not in index:
            raise InputError(f"vertex {id_} is not there, expected one of the file's", file=path, line=number)
    if passed_over:
        kinds = ", ".join(f"{tag[:40]} ({count})" for tag, count in passed_over.most_common(5))
        text = f"{path}: {counted(passed_over.total(), 'line')} passed over, of no pose or edge: {kinds}"
        warnings.warn(MoteslamWarning(text), stacklevel=2)
    ends = np.array([index[id_] for _, id_ in named], np.int64).reshape(-1, 2)
    table = np.array(measured).reshape(-1, 9)
    rows, columns = np.triu_indices(3)
    information = np.zeros((len(table), 3, 3))
    information[:, rows, columns] = information[:, columns, rows] = table[:, 3:]
    return PoseGraph(
        ids=np.array(ids, np.int64),
        poses=np.array([poses[id_] for id_ in ids]),
        first=ends[:, 0],
        second=ends[:, 1],
        relative=table[:, :3],
        information=information,
        stamps=_stamps(path, ids, stamps),
        fixed=np.array([index[id_] for _, id_ in fixed], np.int64),
    )


def _stamps(path: Path, ids: list[int], stamps: dict[int, tuple[int, float]]) -> Array | None:
    """The stamps [n] of the vertices in the order of their ids; None where there are none."""
    if not stamps:
        return None
    if missing := [id_ for id_ in ids if id_ not in stamps]:
        raise InputError(f"vertex {missing[0]} has no stamp, expected one for all or none", file=path)
    found = np.array([stamps[id_][1] for id_ in ids])
    if (back := np.diff(found) < 0).any():
        line = stamps[ids[int(np.argmax(back)) + 1]][0]
        raise InputError("stamp before that of the vertex before, expected rising", file=path, line=line)
    return found


def _split(path: Path, line: int, tag: str, words: list[str]) -> tuple[list[int], list[float]]:
    """The ids and the numbers of a line; more words than these are a comment of their own."""
    ids, count = COUNTS[tag]
    numbers = finite_numbers(words[ids : ids + count])
    if len(words) < ids or numbers is None or len(numbers) != count:
        what = f"{counted(ids, 'id')} and {counted(count, 'finite number')}"
        raise InputError(f"expected {what} after {tag}", file=path, line=line)
    return [_id(word, path, line) for word in words[:ids]], numbers


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
    lines += [f"VERTEX_SE2 {id_} {_shortest(pose)}" for id_, pose in zip(ids, graph.poses.tolist(), strict=True)]
    lines += [f"FIX {ids[index]}" for index in graph.fixed.tolist()]
    upper = graph.information[:, *np.triu_indices(3)]
    edges = zip(graph.first.tolist(), graph.second.tolist(), graph.relative.tolist(), upper.tolist(), strict=True)
    kind = None
    for (first, second, relative, information), loop in zip(edges, graph.loops.tolist(), strict=True):
        if kind != loop:
            lines.append("# loops" if loop else "# chain")
            kind = loop
        lines.append(f"EDGE_SE2 {ids[first]} {ids[second]} {_shortest(relative)} {_shortest(information)}")
    write_atomically(path, "\n".join(lines) + "\n")


def _shortest(numbers: list[float]) -> str:
    """The fewest digits that read back the same."""
    return " ".join(map(repr, numbers))


def vertices_of(path: str | PathLike[str], graph: PoseGraph) -> Trajectory:
    """The vertices of the graph of a file in the order of their ids.

    Their stamps are those of the graph, or as of a KITTI file those beside it, or one a second, which its ``warnings``
    say.
    """
    stamps, issues = stamps_beside(Path(path), len(graph)) if graph.stamps is None else (graph.stamps, ())
    return Trajectory(stamps, graph.poses, warnings=issues)


def write_trajectory(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write a trajectory as a pose graph without edges, the first pose fixed; it reads back the same, bit for bit."""
    expect_type(trajectory, Trajectory, "trajectory")
    none = np.zeros(0, np.int64)
    graph = PoseGraph(
        ids=np.arange(len(trajectory)),
        poses=trajectory.poses,
        first=none,
        second=none,
        relative=np.zeros((0, 3)),
        information=np.zeros((0, 3, 3)),
        stamps=trajectory.stamps,
        fixed=np.arange(min(len(trajectory), 1)),
    )
    write_g2o(path, graph)


def _recognise(comments: str, line: str) -> bool:
    del comments
    tag = line.split(maxsplit=1)[0]
    return tag == "FIX" or tag.startswith(("VERTEX_", "EDGE_", "PARAMS_"))


FORMAT = TrajectoryFormat(
    "g2o (VERTEX_SE2 id x y theta)",
    _recognise,
    lambda path: vertices_of(path, read_g2o(path)),
    write_trajectory,
    (".g2o",),
)
