"""Text files of poses: TUM, EuRoC and other CSV, KITTI.

TUM: Sturm et al. 2012. EuRoC: Burri et al. 2016. KITTI: Geiger, Lenz and Urtasun 2012, the upper three rows of a pose's
matrix a line, the stamps in a file beside. Nothing in a file says whether poses are of a camera: as evo does, the axes
are taken as they are. g2o: its type SE2 (Kuemmerle et al. 2011), an information matrix by the rows of its upper
triangle; the error that it weighs is x, y and heading in the frame of the measured pose. g2o has no stamps. Here a
comment ``# STAMP id seconds`` gives that of a vertex; other programs pass it over.
"""

import re
import warnings
from array import array
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from os import PathLike
from pathlib import Path

import numpy as np

from moteslam.errors import InputError, MoteslamWarning
from moteslam.files import write_atomically
from moteslam.robot import se2
from moteslam.robot.formats.streams import MAX_STAMP
from moteslam.robot.trajectories.columns import (
    Columns,
    all_lines,
    columns_of,
    finite_numbers,
    number_lines,
    seconds,
    separator_of,
    split,
)
from moteslam.robot.trajectory import UNIT, Array, PoseGraph, Trajectory, quaternions_of, trajectory_of
from moteslam.robot.values import Issue, counted, expect_type

EUROC_HEADER = "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z []"
MAX_TURN = 6.3  # Angles beyond this must have a unit
KITTI = "r11 r12 r13 x r21 r22 r23 y r31 r32 r33 z"
G2O, LARGEST_ID = {"VERTEX_SE2": (1, 3), "EDGE_SE2": (2, 9), "# STAMP": (1, 1)}, 2**63 - 1
"""How many ids and then numbers follow; some programs keep a robot's letter in the upper of the 63 bits of an id."""


def write_tum(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``stamp x y z qx qy qz qw`` lines. Headings read back to an ulp or two, all else bit for bit."""
    lines = ["# timestamp tx ty tz qx qy qz qw"]
    lines += [f"{stamp!r} {x!r} {y!r} 0 0 0 {qz!r} {qw!r}" for stamp, x, y, qz, qw in _rows(trajectory)]
    write_atomically(path, "\n".join(lines) + "\n")


def write_euroc(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write ``timestamp [ns],x,y,z,qw,qx,qy,qz`` lines under EuRoC's header.

    Stamps, from 0 to 1e11 s, are rounded to whole nanoseconds, finer than a float64 beyond 97 days.
    """
    rows = _rows(trajectory)
    if rows and not 0 <= rows[0][0] <= rows[-1][0] <= MAX_STAMP:
        raise InputError("stamps below 0 or beyond 1e11 s, expected seconds between", field="stamps")
    whole = ((round(Fraction(stamp) * 10**9), *row) for stamp, *row in rows)
    lines = [EUROC_HEADER, *(f"{stamp},{x!r},{y!r},0,{qw!r},0,0,{qz!r}" for stamp, x, y, qz, qw in whole)]
    write_atomically(path, "\n".join(lines) + "\n")


def _rows(trajectory: Trajectory) -> list[list[float]]:
    """Stamp, x, y and the z and w of the heading's quaternion of each pose."""
    expect_type(trajectory, Trajectory, "trajectory")
    x, y, theta = trajectory.poses.T
    rows: list[list[float]] = np.column_stack((trajectory.stamps, x, y, np.sin(theta / 2), np.cos(theta / 2))).tolist()
    return rows


def read_tum(path: str | PathLike[str]) -> Trajectory:
    """Read a table of TUM, EuRoC or named columns, projected to the plane (x, y and the rotation about z).

    Commas of TUM count as blanks. Stamps are the float64 next to a whole number of nanoseconds.
    """
    from scipy.spatial.transform import Rotation

    path, what = Path(path), "a trajectory of TUM, EuRoC or named columns"
    columns: Columns | None = None
    comments: list[str] = []
    stamps: list[str] = []
    rows, lines = array("d"), array("q")
    for number, line in all_lines(path, what):
        if line.startswith(("#", "%")):
            comments.append(line)
            continue
        if columns is None:
            try:
                columns, is_header = columns_of(comments, line)
            except ValueError as error:
                raise InputError(str(error), file=path, line=number) from error
            names = [name for name in columns.at if name not in ("t", "nsec")]
            is_tum = not columns.names and columns.unit is None
            separator = separator_of(line)
            separator = None if is_tum and separator == "," else separator  # commas of TUM count as blanks
            width = len(split(line, separator))
            if (most := max(columns.at.values()) + 1) > width:
                raise InputError(f"{counted(width, 'column')}, expected {most}, as named", file=path, line=number)
            if is_header:
                continue
        words = split(line, separator)
        if len(words) < width or any(words[width:]):
            problem = f"{counted(len(words), 'column')}, expected {width}, as above (decimal commas need semicolons)"
            raise InputError(problem, file=path, line=number)
        row, stamp = finite_numbers([words[columns.at[name]] for name in names]), _stamp(words, columns)
        if row is None or stamp is None:
            name = next((name for name in names if stamp and finite_numbers([words[columns.at[name]]]) is None), "t")
            numbers = "whole nanoseconds" if name == "t" and columns.unit == "ns" else "a finite number"
            problem = f"{words[columns.at[name]][:40]!r}, expected {numbers}"
            raise InputError(problem, file=path, line=number, field=name)
        stamps.append(stamp)
        rows.extend(row)
        lines.append(number)
    if columns is None or not lines:
        raise InputError(f"no poses, expected {what}", file=path)
    times, issues = seconds(stamps, path, lines, columns.unit)
    values = np.array(rows).reshape(len(lines), -1).T
    table = {name: some * columns.scale.get(name, 1.0) for name, some in zip(names, values, strict=True)}
    quaternions, else_turned = None, dict[str, Array]()
    if "qw" in table:
        quaternions = np.column_stack([table[name] for name in ("qx", "qy", "qz", "qw")])
        if not columns.names:
            read, other = ("qx qy qz qw", "qw qx qy qz")[:: 1 if is_tum else -1]
            else_turned[f"{other} (put # t x y z {other} first)"] = np.roll(quaternions, -1 if is_tum else 1, axis=1)
            if not is_tum:
                text = f"{path}: no names of columns: its orientations are taken for {read}; put # t x y z {read} first"
                issues += (Issue("orientation-order", text, len(lines)),)
    elif "yaw" in table:
        if "yaw" not in columns.scale and np.abs(table["yaw"]).max() > MAX_TURN:
            raise InputError("angles beyond 6.3, expected a unit in the header: yaw [rad] or yaw [deg]", file=path)
        # about the fixed axes x, y, z, in this order (ROS REP 103)
        angles = np.column_stack([table.get(name, np.zeros(len(lines))) for name in ("roll", "pitch", "yaw")])
        unit, factor = ("degrees", np.pi / 180) if columns.scale.get("yaw", 1.0) == 1.0 else ("radians", 180 / np.pi)
        quaternions, else_turned[unit] = (Rotation.from_euler("xyz", by * angles).as_quat() for by in (1, factor))
    positions = np.column_stack((table["x"], table["y"], table.get("z", np.zeros(len(lines)))))
    return trajectory_of(path, times, positions, quaternions, lines=lines, warnings=issues, else_turned=else_turned)


def _stamp(words: Sequence[str], columns: Columns) -> str | None:
    """The word of a stamp; of seconds and nanoseconds apart, nanoseconds; None where it is not a finite number."""
    stamp = words[columns.at["t"]][:40]
    if "nsec" in columns.at:
        rest = words[columns.at["nsec"]]
        whole = stamp.isdecimal() and rest.isdecimal() and max(len(stamp), len(rest)) < 12
        return str(int(stamp) * 10**9 + int(rest)) if whole else None
    number = finite_numbers([stamp])
    return stamp if number is not None and (columns.unit != "ns" or number[0].is_integer()) else None


def times_file(path: Path) -> Path:
    """The file beside a trajectory that has its stamps: ``NAME.times.txt`` beside ``NAME.kitti``."""
    return path.with_name(f"{path.stem}.times.txt")


def stamps_beside(path: Path, count: int) -> tuple[Array, tuple[Issue, ...]]:
    """The stamps [count] [s] of a trajectory without any: ``NAME.times.txt``, ``times.txt``, else one a second."""
    for file in (times_file(path), path.with_name("times.txt")):
        if file.exists():
            rows, lines = number_lines(file, "times", 1, "seconds")
            stamps, issues = seconds([word for (word,) in rows], file, lines)
            if len(stamps) != count:
                raise InputError(f"{counted(len(stamps), 'time')}, expected {count}, one a pose", file=file)
            return stamps, issues
    text = f"{path}: has no stamps, and no {times_file(path).name} or times.txt lies beside it; taken as one a second"
    return np.arange(count, dtype=np.float64), (Issue("no-stamps", text, count),)


def read_kitti(path: str | PathLike[str]) -> Trajectory:
    """Read a KITTI trajectory, projected to the plane, with the stamps of `stamps_beside`."""
    path = Path(path)
    rows, lines = number_lines(path, "a KITTI trajectory", 12, KITTI)
    matrices = np.array(rows, np.float64).reshape(-1, 3, 4)
    rotation, position = matrices[:, :, :3], matrices[:, :, 3]
    off = np.abs(rotation @ np.swapaxes(rotation, 1, 2) - np.eye(3)).max(axis=(1, 2))
    if (bad := (off > UNIT) | (np.linalg.det(rotation) <= 0)).any():
        raise InputError("expected a rotation matrix in columns 1 to 3", file=path, line=lines[int(np.argmax(bad))])
    stamps, issues = stamps_beside(path, len(rows))
    found = trajectory_of(path, stamps, position, quaternions_of(rotation), lines=lines, warnings=issues)
    # as written, without a way through quaternions
    heading = se2.wrap(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]))
    return replace(found, poses=np.column_stack((position[:, :2], heading)))


def write_kitti(path: str | PathLike[str], trajectory: Trajectory) -> None:
    """Write twelve numbers a line, and the stamps to ``NAME.times.txt`` beside.

    Stamps and positions read back bit for bit, headings, which go through cosine and sine, to an ulp or two.
    """
    expect_type(trajectory, Trajectory, "trajectory")
    rows = np.zeros((len(trajectory), 3, 4))
    rows[:, :2, 3] = trajectory.poses[:, :2]
    cos, sin = np.cos(trajectory.poses[:, 2]), np.sin(trajectory.poses[:, 2])
    rows[:, 0, 0], rows[:, 0, 1], rows[:, 1, 0], rows[:, 1, 1], rows[:, 2, 2] = cos, -sin, sin, cos, 1.0
    write_atomically(times_file(Path(path)), "".join(f"{stamp!r}\n" for stamp in trajectory.stamps.tolist()))
    words = (" ".join(map(repr, row)) for row in (rows.reshape(-1, 12) + 0.0).tolist())  # + 0.0: no -0
    write_atomically(path, "\n".join(words) + "\n")


def read_g2o(path: str | PathLike[str]) -> PoseGraph:
    """Read a pose graph in the plane.

    Landmarks, parameters and all else that is not a pose or an edge between poses is passed over, with a warning that
    counts it; vertices and edges in space (``SE3:QUAT``) are refused.
    """
    path = Path(path)
    found: dict[str, list[tuple[int, list[int], list[float]]]] = {tag: [] for tag in (*G2O, "FIX")}
    passed_over: Counter[str] = Counter()
    for number, line in all_lines(path, "a g2o pose graph"):
        words = line.split()
        tag = " ".join(words[:2]) if words[0] == "#" else words[0]
        if tag in found:
            words = line.removeprefix(tag).split()
            named, count = G2O.get(tag, (len(words), 0))
            numbers = finite_numbers(words[named : named + count])
            if len(words) < named or numbers is None or len(numbers) != count:
                what = f"{counted(named, 'id')} and {counted(count, 'finite number')}"
                raise InputError(f"expected {what} after {tag}", file=path, line=number)
            for word in words[:named]:
                if not re.fullmatch("[0-9]{1,19}", word) or int(word) > LARGEST_ID:
                    raise InputError(f"{word[:40]!r}, expected the id of a vertex", file=path, line=number)
            found[tag].append((number, [int(word) for word in words[:named]], numbers))
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
            raise InputError("stamp before that of the vertex before, expected rising", file=path, line=seconds[id_][1])
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
