"""g2o: a pose graph in lines, a vertex or an edge each.

Source: the types SE2 and SE3 of g2o (Kuemmerle et al. 2011). An information matrix is written by the rows of its upper
triangle. The error that it weighs is, of SE2, x, y and heading in the frame of the measured pose; of SE3, x, y, z and
the vector part of the unit quaternion, which is half of a small angle.

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
from moteslam.robot import se2
from moteslam.robot.files import write_atomically
from moteslam.robot.trajectories.rows import TrajectoryFormat, all_lines, finite_numbers, stamps_beside
from moteslam.robot.trajectory import UNIT, Array, PoseGraph, Trajectory, quaternion_of_yaw, trajectory_of
from moteslam.robot.values import counted, expect_type

VERTICES = {"VERTEX_SE2": 3, "VERTEX_SE3:QUAT": 7}
"""Numbers after the id."""
EDGES = {"EDGE_SE2": 9, "EDGE_SE3:QUAT": 28}
"""Numbers after the two ids."""
STAMP = "STAMP"
LARGEST_ID = 2**63 - 1
"""Some programs keep a robot's letter in the upper bits of an id: of 64, one for the sign."""
PLANAR = [0, 1, 5]
"""Of the six errors of SE3: x, y and that about z."""


def read_g2o(path: str | PathLike[str]) -> PoseGraph:
    """Read a pose graph; vertices and edges of SE3 are projected to the plane.

    Of the information about SE3 that about x, y and the heading is kept: of a robot that stays in the plane. Landmarks,
    parameters and all else that is no pose or edge between poses is passed over, with a warning that counts it.
    """
    return _Lines(Path(path)).graph()


def read_both(path: str | PathLike[str]) -> tuple[PoseGraph, Trajectory]:
    """A pose graph, and its vertices as a trajectory.

    Their stamps are those in the file, or as of a KITTI file those beside it, or one a second, which its ``warnings``
    say.
    """
    path = Path(path)
    lines = _Lines(path)
    graph = lines.graph()
    stamps, issues = stamps_beside(path, len(graph)) if graph.stamps is None else (graph.stamps, ())
    if not lines.spatial:
        return graph, Trajectory(stamps, graph.poses, warnings=issues)
    z, w = quaternion_of_yaw(graph.poses[:, 2])
    flat = dict(zip(graph.ids.tolist(), zip(*graph.poses[:, :2].T.tolist(), z, w, strict=True), strict=True))
    rows = [lines.spatial.get(id_) or [x, y, 0.0, 0.0, 0.0, z, w] for id_, (x, y, z, w) in flat.items()]
    table = np.array(rows)
    return graph, trajectory_of(path, stamps, table[:, :3], table[:, 3:], warnings=issues)


def write_g2o(path: str | PathLike[str], graph: PoseGraph, *, comments: Sequence[str] = ()) -> None:
    """Write a pose graph as ``VERTEX_SE2``, ``FIX`` and ``EDGE_SE2`` lines; it reads back the same, bit for bit.

    Stamps are comments ``# STAMP id seconds`` before the vertices. Before edges that are loops stands ``# loops``,
    before those of the chain ``# chain``. ``comments`` are lines to begin with.
    """
    expect_type(graph, PoseGraph, "graph")
    ids = graph.ids.tolist()
    lines = [f"# {comment}" for comment in comments]
    if graph.stamps is not None:
        lines += [f"# {STAMP} {id_} {stamp!r}" for id_, stamp in zip(ids, graph.stamps.tolist(), strict=True)]
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


def read_trajectory(path: str | PathLike[str]) -> Trajectory:
    """The vertices of a pose graph in the order of their ids, as a trajectory; see `read_both`."""
    return read_both(path)[1]


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


class _Lines:
    """What the lines of a file say."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.poses: dict[int, list[float]] = {}  # by id
        self.spatial: dict[int, list[float]] = {}  # position and quaternion by id
        self.edges: list[tuple[int, int, int]] = []  # line and ids
        self.measured: list[list[float]] = []
        self.fixed: list[tuple[int, int]] = []  # line and id
        self.stamps: dict[int, tuple[int, float]] = {}  # line and seconds, by id
        self.passed_over: Counter[str] = Counter()
        for number, line in all_lines(path, "a g2o pose graph"):
            self._take(number, line.split())

    def _take(self, line: int, words: list[str]) -> None:
        tag, *rest = words
        if tag in VERTICES:
            (id_,), numbers = self._split(line, tag, rest, ids=1, count=VERTICES[tag])
            if id_ in self.poses:
                raise InputError(f"vertex {id_} stands twice, expected it once", file=self.path, line=line)
            if len(numbers) == 7:
                self.spatial[id_] = numbers
            self.poses[id_] = self._planar(line, numbers)
        elif tag in EDGES:
            (first, second), numbers = self._split(line, tag, rest, ids=2, count=EDGES[tag])
            if first == second:
                raise InputError(f"an edge from {first} to itself, expected two vertices", file=self.path, line=line)
            places = 3 if tag == "EDGE_SE2" else 7
            self.edges.append((line, first, second))
            self.measured.append(
                [*self._planar(line, numbers[:places]), *_planar_information(numbers[places:]).ravel().tolist()]
            )
        elif tag == "FIX":
            self.fixed += [(line, self._id(word, line)) for word in rest]
        elif words[:2] == ["#", STAMP]:
            (id_,), (stamp,) = self._split(line, f"# {STAMP}", words[2:], ids=1, count=1)
            self.stamps[id_] = (line, stamp)
        elif not tag.startswith("#"):
            self.passed_over[tag] += 1

    def graph(self) -> PoseGraph:
        """The graph of all lines."""
        if not self.poses:
            expected = "expected g2o lines: VERTEX_SE2 id x y theta or VERTEX_SE3:QUAT id x y z qx qy qz qw"
            raise InputError(f"no poses, {expected}", file=self.path)
        ids = sorted(self.poses)
        index = {id_: k for k, id_ in enumerate(ids)}
        ends = [(self._index(index, a, line), self._index(index, b, line)) for line, a, b in self.edges]
        fixed = [self._index(index, id_, line) for line, id_ in self.fixed]
        measured = np.array(self.measured).reshape(-1, 12)
        if self.passed_over:
            kinds = ", ".join(f"{tag[:40]} ({count})" for tag, count in self.passed_over.most_common(5))
            text = f"{self.path}: {counted(self.passed_over.total(), 'line')} passed over, of no pose or edge: {kinds}"
            warnings.warn(MoteslamWarning(text), stacklevel=3)
        return PoseGraph(
            ids=np.array(ids, np.int64),
            poses=np.array([self.poses[id_] for id_ in ids]),
            first=np.array([first for first, _ in ends], np.int64),
            second=np.array([second for _, second in ends], np.int64),
            relative=measured[:, :3],
            information=measured[:, 3:].reshape(-1, 3, 3),
            stamps=self._stamps(index),
            fixed=np.array(fixed, np.int64),
        )

    def _stamps(self, index: dict[int, int]) -> Array | None:
        """The stamps [n] of the vertices in the order of their ids; None where there are none."""
        if not self.stamps:
            return None
        stamps = np.full(len(index), np.nan)
        for id_, (line, stamp) in self.stamps.items():
            stamps[self._index(index, id_, line)] = stamp
        if np.isnan(stamps).any():
            missing = next(id_ for id_ in index if id_ not in self.stamps)
            raise InputError(f"vertex {missing} has no stamp, expected one for all or none", file=self.path)
        if (np.diff(stamps) < 0).any():
            back = list(index)[int(np.argmax(np.diff(stamps) < 0)) + 1]
            line = self.stamps[back][0]
            raise InputError("stamp before that of the vertex before, expected rising", file=self.path, line=line)
        return stamps

    def _split(self, line: int, tag: str, words: list[str], *, ids: int, count: int) -> tuple[list[int], list[float]]:
        """The ids and the numbers of a line; more words than these are a comment of their own."""
        numbers = finite_numbers(words[ids : ids + count])
        if len(words) < ids or numbers is None or len(numbers) != count:
            what = f"{counted(ids, 'id')} and {counted(count, 'finite number')}"
            raise InputError(f"expected {what} after {tag}", file=self.path, line=line)
        return [self._id(word, line) for word in words[:ids]], numbers

    def _id(self, word: str, line: int) -> int:
        if word.isascii() and word.isdecimal() and len(word) <= len(str(LARGEST_ID)) and int(word) <= LARGEST_ID:
            return int(word)
        raise InputError(f"{word[:40]!r}, expected the id of a vertex", file=self.path, line=line)

    def _index(self, index: dict[int, int], id_: int, line: int) -> int:
        if id_ not in index:
            raise InputError(f"vertex {id_} is not there, expected one of the file's", file=self.path, line=line)
        return index[id_]

    def _planar(self, line: int, numbers: list[float]) -> list[float]:
        """x, y and heading of three or seven numbers."""
        if len(numbers) == 3:
            return numbers
        if not abs((length := float(np.linalg.norm(numbers[3:]))) - 1) <= UNIT:
            raise InputError(f"quaternion of length {length:.3g}, expected one of length 1", file=self.path, line=line)
        return [*numbers[:2], float(se2.heading(numbers[3:]))]


def _planar_information(upper: list[float]) -> Array:
    """The information [3, 3] about x, y and heading, of the upper triangle of that of SE2 or SE3."""
    size = 3 if len(upper) == 6 else 6
    information = np.zeros((size, size))
    rows, columns = np.triu_indices(size)
    information[rows, columns] = information[columns, rows] = upper
    if size == 3:
        return information
    per_angle = np.array((1.0, 1.0, 0.5))  # the error of SE3 is half of the angle
    return information[np.ix_(PLANAR, PLANAR)] * np.outer(per_angle, per_angle)


def _shortest(numbers: list[float]) -> str:
    """The fewest digits that read back the same."""
    return " ".join(map(repr, numbers))


def _recognise(comments: str, line: str) -> bool:
    del comments
    tag = line.split(maxsplit=1)[0]
    return tag in (*VERTICES, *EDGES, "FIX") or tag.startswith(("VERTEX_", "EDGE_", "PARAMS_"))


FORMAT = TrajectoryFormat("g2o (VERTEX_SE2 id x y theta)", _recognise, read_trajectory, write_trajectory, (".g2o",))
