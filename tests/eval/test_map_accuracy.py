"""A map against the true one: perfect is perfect, and what is worse scores worse."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.errors import InputError
from moteslam.eval.metrics.map_quality import FARTHEST, map_accuracy
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.raster import Raster

CELL = 0.05


def room(cell: float = CELL) -> Raster:
    """A room of 8 m by 5 m with a pillar, its walls 20 cm thick, unknown outside."""

    def cells(low: float, high: float) -> slice:
        return slice(round((low + 0.5) / cell), round((high + 0.5) / cell))

    values = np.full((round(6 / cell), round(9 / cell)), UNKNOWN, np.int8)
    values[cells(-0.2, 5.2), cells(-0.2, 8.2)] = OCCUPIED
    values[cells(0, 5), cells(0, 8)] = FREE
    values[cells(1.5, 2), cells(2.5, 3.5)] = OCCUPIED
    return Raster(values, cell, (-1.0, 2.0, 0.0))


def surface_alone(true: Raster) -> Raster:
    """As a robot maps it: of each wall the cells that it sees."""
    values = true.values.copy()
    free = np.pad(values == FREE, 1)
    beside = sum(np.roll(free, shift, (0, 1)) for shift in ((1, 0), (-1, 0), (0, 1), (0, -1)))[1:-1, 1:-1] > 0
    values[(values == OCCUPIED) & ~beside] = UNKNOWN
    return Raster(values, true.cell_size, true.origin)


def shifted(raster: Raster, by: float) -> Raster:
    x, y, yaw = raster.origin
    return Raster(raster.values, raster.cell_size, (x + by, y, yaw))


def test_perfect_is_perfect() -> None:
    true = room()
    score = map_accuracy(surface_alone(true), true)
    assert (score.precision, score.recall, score.f1, score.free_iou, score.known) == (1, 1, 1, 1, 1)
    assert score.distance == 0.0


def test_perfect_is_perfect_in_another_frame() -> None:
    """The map in the robot's frame, the truth in the world's."""
    true = room()
    pose = np.array([3.0, -2.0, 0.7])
    x, y, yaw = se2.compose(pose, np.array(true.origin))
    turned = Raster(surface_alone(true).values, true.cell_size, (x, y, yaw))
    score = map_accuracy(turned, true, transform=se2.inverse(pose))
    assert (score.precision, score.recall) == (1, 1)
    assert score.free_iou > 0.999
    assert score.distance < 1e-9


def test_a_shifted_map_falls_monotonically() -> None:
    true = room()
    shifts = (0.0, 0.04, 0.08, 0.12, 0.2, 0.3, 0.5)
    scores = [map_accuracy(shifted(surface_alone(true), by), true) for by in shifts]
    for name in ("f1", "precision", "recall", "free_iou"):
        values = np.array([getattr(score, name) for score in scores])
        assert (np.diff(values) <= 0).all(), name
        assert values[-1] < 0.97 * values[0], name
    distances = [score.distance for score in scores]
    assert (np.diff(distances) > 0).all()
    assert max(distances) < FARTHEST


def test_a_wall_drawn_twice_is_noticed() -> None:
    true = room()
    twice = surface_alone(true)
    values = twice.values.copy()
    values[20, 20:150] = OCCUPIED
    score = map_accuracy(Raster(values, twice.cell_size, twice.origin), true)
    assert score.precision < 0.9
    assert score.recall == 1
    assert score.distance > 0.01


def test_what_was_not_mapped_costs_recall_where_it_was_seen_and_not_precision() -> None:
    true = room()
    half = surface_alone(true).values.copy()
    half[:, 90:] = UNKNOWN
    mapped = Raster(half, true.cell_size, true.origin)
    score = map_accuracy(mapped, true)
    assert (score.precision, score.free_iou) == (1, 1)
    assert score.recall == pytest.approx(0.5, abs=0.08)
    assert score.known == pytest.approx(0.5, abs=0.08)
    seen = map_accuracy(mapped, true, seen=mapped.centres(np.argwhere(half == OCCUPIED)))
    assert seen.recall == 1
    assert seen.surface < score.surface


def test_a_wall_inside_a_wall_is_off_by_its_depth() -> None:
    """The true walls are thick: what lies inside of them is not on their surface."""
    true = room()
    score = map_accuracy(true, true)  # all of the thick walls drawn
    assert score.precision < 1
    assert score.recall == 1


def test_cells_of_other_sizes_compare() -> None:
    score = map_accuracy(surface_alone(room(0.1)), room(0.05))
    assert score.f1 > 0.9
    assert score.free_iou > 0.95


@pytest.mark.parametrize(
    ("values", "field"),
    [(np.full((5, 5), FREE, np.int8), "estimate"), (np.full((5, 5), 7, np.int8), "estimate")],
)
def test_maps_that_cannot_be_scored(values: np.ndarray, field: str) -> None:
    with pytest.raises(InputError, match=rf"^{field}: "):
        map_accuracy(Raster(values, CELL), room())
    with pytest.raises(InputError, match=r"^truth: "):
        map_accuracy(surface_alone(room()), Raster(values, CELL))
    with pytest.raises(InputError, match=r"^truth: no wall that was seen"):
        map_accuracy(surface_alone(room()), room(), seen=np.array([[100.0, 100.0]]))
