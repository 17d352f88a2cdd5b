"""g2o files: pose graphs that read back, and lines that are refused."""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from refusals import refusal

from moteslam.errors import InputError, MoteslamWarning
from moteslam.robot.trajectories.text import read_g2o, write_g2o
from moteslam.robot.trajectory import PoseGraph

INFORMATION = "1 0 0 1 0 1"


def a_graph(seed: int, *, n: int = 6, stamps: bool = True) -> PoseGraph:
    """A chain of poses with loops, all numbers at random."""
    generator = np.random.default_rng(seed)
    first, second = np.r_[np.arange(n - 1), n - 1, 0], np.r_[np.arange(1, n), 0, n - 2]
    half = generator.normal(size=(n + 1, 3, 3))
    information = half + np.swapaxes(half, 1, 2)
    return PoseGraph(
        ids=np.cumsum(generator.integers(1, 1000, n)),
        poses=generator.normal(size=(n, 3)),
        first=first,
        second=second,
        relative=generator.normal(size=(n + 1, 3)),
        information=information,
        stamps=np.sort(generator.uniform(0, 2e9, n)) if stamps else None,
        fixed=np.array([0]),
    )


def arrays_of(graph: PoseGraph) -> dict[str, Any]:
    names = ("ids", "poses", "first", "second", "relative", "information", "stamps", "fixed")
    return {name: None if (value := getattr(graph, name)) is None else value.tolist() for name in names}


@given(st.integers(0, 2**32), st.booleans())
def test_a_graph_reads_back_bit_for_bit(seed: int, stamps: bool) -> None:
    graph = a_graph(seed, stamps=stamps)
    with tempfile.TemporaryDirectory() as folder:
        write_g2o(Path(folder) / "g.g2o", graph, comments=["made by a test"])
        again = read_g2o(Path(folder) / "g.g2o")
        text = (Path(folder) / "g.g2o").read_text()
    assert arrays_of(again) == arrays_of(graph)
    assert again.loops.tolist() == [False] * 5 + [True] * 2
    assert text.index("# chain") < text.index("# loops")


def test_vertices_in_any_order_are_sorted_and_edges_keep_their_direction(tmp_path: Path) -> None:
    (tmp_path / "g.g2o").write_text(
        f"VERTEX_SE2 7 1 2 3\nEDGE_SE2 9 2 1 0 0 {INFORMATION}\nVERTEX_SE2 2 0 0 0\nVERTEX_SE2 9 4 5 -3\nFIX 2 9\n"
    )
    graph = read_g2o(tmp_path / "g.g2o")
    assert graph.ids.tolist() == [2, 7, 9]
    assert graph.poses.tolist() == [[0, 0, 0], [1, 2, 3], [4, 5, -3]]
    assert (graph.first.tolist(), graph.second.tolist(), graph.loops.tolist()) == ([2], [0], [True])
    assert graph.fixed.tolist() == [0, 2]


def test_what_is_no_pose_is_passed_over_with_a_count(tmp_path: Path) -> None:
    (tmp_path / "g.g2o").write_text("VERTEX_SE2 0 0 0 0\nVERTEX_XY 1 0 0\nVERTEX_XY 2 0 0\nEDGE_SE2_XY 0 1 0 0 1 0 1\n")
    with pytest.warns(MoteslamWarning, match=r"3 lines passed over, of no pose or edge: VERTEX_XY \(2\), EDGE_SE2_XY"):
        assert len(read_g2o(tmp_path / "g.g2o")) == 1


VERTEX = "VERTEX_SE2 0 0 0 0\nVERTEX_SE2 1 1 0 0\n"


@pytest.mark.parametrize(
    ("text", "line"),
    [
        ("", None),
        ("FIX 0\n", None),
        (VERTEX + "VERTEX_SE2 2 0 0\n", 3),
        (VERTEX + "VERTEX_SE2 -2 0 0 0\n", 3),
        (VERTEX + f"VERTEX_SE2 {'9' * 5000} 0 0 0\n", 3),
        (VERTEX + "VERTEX_SE2 1 0 0 0\n", 3),
        (VERTEX + "VERTEX_SE3:QUAT 2 0 0 0 0 0 0 1\n", 3),
        (VERTEX + "EDGE_SE2 0 1 0 0 0 1 0 0 1 0\n", 3),
        (VERTEX + f"EDGE_SE2 0 0 0 0 0 {INFORMATION}\n", 3),
        (VERTEX + f"EDGE_SE2 0 5 0 0 0 {INFORMATION}\n", 3),
        (VERTEX + "FIX 5\n", 3),
        (VERTEX + "# STAMP 0 1\n", None),
        (VERTEX + "# STAMP 0 1\n# STAMP 1 0\n", 4),
    ],
)
def test_bad_lines_are_told_with_their_number(tmp_path: Path, text: str, line: int | None) -> None:
    (tmp_path / "g.g2o").write_text(text)
    with refusal(InputError, file=tmp_path / "g.g2o", line=line):
        read_g2o(tmp_path / "g.g2o")


@pytest.mark.parametrize(
    "changes",
    [
        {"poses": np.zeros((5, 3))},
        {"ids": np.zeros(6)},
        {"stamps": -np.arange(6.0)},
        {"first": np.full(7, 6)},
        {"second": np.r_[np.arange(5), 5, 0]},
    ],
)
def test_a_graph_that_is_none_is_refused(changes: dict[str, Any]) -> None:
    (field,) = changes
    with refusal(InputError, field=field):
        replace(a_graph(0), **changes)
