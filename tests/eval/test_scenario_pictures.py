"""Pictures of scenarios: what they show, which way arrows point, and that no text lies on other text."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from figures import legend_of
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from moteslam.eval.report.scenarios import along, draw_scenario
from moteslam.sim.scenario import Scenario, load_scenario


def boxes_of_texts(axes: Axes) -> np.ndarray:
    """The corners [n, 4] of all texts in pixels: left, bottom, right, top."""
    boxes = [text.get_window_extent() for text in axes.texts]
    return np.array([(box.x0, box.y0, box.x1, box.y1) for box in boxes]).reshape(-1, 4)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["big_loop", "doors", "lab", "office", "people", "slippery", "random-corridors-3"])
def test_texts_lie_inside_the_plan_and_not_on_each_other(name: str, tmp_path: Path, drawn: list[Figure]) -> None:
    scenario = load_scenario(name)
    draw_scenario(tmp_path / "x.png", scenario)
    (axes,) = drawn[0].axes
    drawn[0].draw_without_rendering()  # at the resolution that sizes are measured in
    boxes = boxes_of_texts(axes)
    expected = len(scenario.people) + len(scenario.doors) + len(scenario.world.slippery)
    assert len(boxes) - expected in {1, 2}  # start and goal may be one
    area = axes.get_window_extent()
    assert (boxes[:, :2] >= (area.x0, area.y0)).all()
    assert (boxes[:, 2:] <= (area.x1, area.y1)).all()
    for i, box in enumerate(boxes):
        others = boxes[i + 1 :]
        apart = (others[:, :2] >= box[2:]) | (others[:, 2:] <= box[:2])
        assert apart.any(axis=1).all()
    legend = drawn[0].legends[0].get_window_extent()
    assert legend.y1 < axes.get_window_extent().y0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x [m]", "y [m]")


def test_free_space_is_white_and_the_rest_grey(tmp_path: Path, drawn: list[Figure]) -> None:
    scenario = load_scenario("loop")
    draw_scenario(tmp_path / "x.png", scenario)
    (axes,) = drawn[0].axes
    (picture,) = axes.images
    left, right, bottom, top = picture.get_extent()
    rest = ~np.ma.getmaskarray(picture.get_array())

    def grey_at(x: float, y: float) -> bool:
        rows, columns = rest.shape
        return bool(rest[int((y - bottom) / (top - bottom) * rows), int((x - left) / (right - left) * columns)])

    assert not grey_at(*scenario.start[:2])
    assert not grey_at(11.0, 17.0)  # a room behind an open door, at the top
    assert grey_at(11.0, 7.0)  # inside the loop


def test_arrows_point_along_the_route_on_its_right(tmp_path: Path, drawn: list[Figure]) -> None:
    there_and_back = {"route": {"waypoints": [[1.0, 1.0], [9.0, 1.0], [1.0, 1.0]]}}
    room = {"world": {"rooms": [{"corner": [0.0, 0.0], "size": [10.0, 2.0]}]}}
    draw_scenario(tmp_path / "x.png", Scenario.model_validate({**room, **there_and_back}))
    (axes,) = drawn[0].axes
    (arrows,) = [c for c in axes.collections if c.get_zorder() == 3]
    np.testing.assert_allclose(arrows.V, 0, atol=1e-9)
    there = arrows.U > 0
    assert 0 < there.sum() < len(there)
    assert (arrows.Y[there] < 1).all()
    assert (arrows.Y[~there] > 1).all()
    assert "route, 16 m" in legend_of(drawn[0])


def test_the_legend_names_what_is_there(tmp_path: Path, drawn: list[Figure]) -> None:
    draw_scenario(tmp_path / "a.png", load_scenario("lab"))
    draw_scenario(tmp_path / "b.png", load_scenario("people"))
    draw_scenario(tmp_path / "c.png", load_scenario("doors"))
    lab, people, doors = map(legend_of, drawn)
    assert lab == [
        *("free space", "shelf (3)", "table (7)", "chair (8)", "box (6)", "wall", "black", "shiny"),
        *("start", "route, 80 m", "goal"),
    ]
    assert people[-2:] == ["person, there and back", "person, strolls about"]
    assert doors[-2:] == ["door, shut", "door, as it opens"]


def test_places_along_a_line_are_even() -> None:
    places, directions = along(np.array([(0.0, 0.0), (4.0, 0.0), (4.0, 0.0), (4.0, 4.0)]), 2.0)
    np.testing.assert_allclose(places, [(1, 0), (3, 0), (4, 1), (4, 3)])
    np.testing.assert_allclose(directions, [(1, 0), (1, 0), (0, 1), (0, 1)])
    still, _ = along(np.zeros((2, 2)), 1.0)
    np.testing.assert_array_equal(still, np.zeros((1, 2)))
