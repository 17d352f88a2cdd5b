"""A map against the true one, and the map that scans draw: perfect is perfect, and what is worse scores worse."""

from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from box_ranges import box_ranges

from moteslam.errors import InputError
from moteslam.eval.metrics.map_quality import FARTHEST, MapConsistency, map_accuracy, map_consistency
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, UNKNOWN
from moteslam.robot.platform import Platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import LidarStream, OdometryStream, Recording
from moteslam.robot.trajectory import Trajectory

CELL = 0.05
WIDE, TALL = 12.0, 8.0
ANGLES = np.deg2rad(np.arange(-180.0, 180.0, 1.5))


def room(cell: float = CELL) -> Raster:
    """A room of 8 m by 5 m with a pillar, its walls 20 cm thick, unknown outside."""

    def cells(low: float, high: float) -> slice:
        return slice(round((low + 0.5) / cell), round((high + 0.5) / cell))

    values = np.full((round(6 / cell), round(9 / cell)), UNKNOWN, np.int8)
    values[cells(-0.2, 5.2), cells(-0.2, 8.2)] = OCCUPIED
    values[cells(0, 5), cells(0, 8)] = FREE
    values[cells(1.5, 2), cells(2.5, 3.5)] = OCCUPIED
    return Raster(values, cell, (-1.0, 2.0, 0.0))


def mapped(cell: float = CELL, *, by: float = 0.0) -> Raster:
    """The room as a robot maps it, of each wall the cells that it sees; shifted along x [m]."""
    true = room(cell)
    values = true.values.copy()
    free = np.pad(values == FREE, 1)
    beside = sum(np.roll(free, shift, (0, 1)) for shift in ((1, 0), (-1, 0), (0, 1), (0, -1)))[1:-1, 1:-1] > 0
    values[(values == OCCUPIED) & ~beside] = UNKNOWN
    x, y, yaw = true.origin
    return Raster(values, cell, (x + by, y, yaw))


def test_perfect_is_perfect_in_any_frame() -> None:
    """The second time the map is in the robot's frame, the truth in the world's."""
    true, seen = room(), mapped()
    score = map_accuracy(seen, true)
    assert (score.precision, score.recall, score.f1, score.free_iou, score.known) == (1, 1, 1, 1, 1)
    assert score.distance == 0.0
    pose = np.array([3.0, -2.0, 0.7])
    x, y, yaw = se2.compose(pose, np.array(true.origin))
    score = map_accuracy(Raster(seen.values, CELL, (x, y, yaw)), true, transform=se2.inverse(pose))
    assert (score.precision, score.recall) == (1, 1)
    assert score.free_iou > 0.999
    assert score.distance < 1e-9


def test_a_shifted_map_falls_monotonically() -> None:
    scores = [map_accuracy(mapped(by=by), room()) for by in (0.0, 0.04, 0.08, 0.12, 0.2, 0.3, 0.5)]
    for name in ("f1", "precision", "recall", "free_iou"):
        values = np.array([getattr(score, name) for score in scores])
        assert (np.diff(values) <= 0).all(), name
        assert values[-1] < 0.97 * values[0], name
    distances = [score.distance for score in scores]
    assert (np.diff(distances) > 0).all()
    assert max(distances) < FARTHEST


def test_walls_drawn_twice_or_inside_of_a_wall_are_noticed() -> None:
    """The true walls are thick: a line inside of them is not on their surface. A filled pillar is right."""
    values = mapped().values.copy()
    pillar = slice(40, 50), slice(60, 80)
    assert (room().values[pillar] == OCCUPIED).all()
    assert (values[pillar] == UNKNOWN).any()
    filled = values.copy()
    filled[pillar] = OCCUPIED
    assert map_accuracy(Raster(filled, CELL, room().origin), room()).precision == 1
    values[20, 20:150] = OCCUPIED
    twice = map_accuracy(Raster(values, CELL, room().origin), room())
    assert twice.precision < 0.9
    assert twice.distance > 0.01
    thick = map_accuracy(room(), room())
    assert thick.precision < 1
    assert twice.recall == thick.recall == 1


def test_what_was_not_mapped_costs_recall_where_it_was_seen_and_not_precision() -> None:
    values = mapped().values.copy()
    values[:, 90:] = UNKNOWN
    half = Raster(values, CELL, room().origin)
    score = map_accuracy(half, room())
    assert (score.precision, score.free_iou) == (1, 1)
    assert score.recall == pytest.approx(0.5, abs=0.08)
    assert score.known == pytest.approx(0.5, abs=0.08)
    seen = map_accuracy(half, room(), seen=half.centres(np.argwhere(values == OCCUPIED)))
    assert seen.recall == 1
    assert seen.surface < score.surface


def test_cells_of_other_sizes_compare() -> None:
    score = map_accuracy(mapped(0.1), room(0.05))
    assert score.f1 > 0.9
    assert score.free_iou > 0.95


@pytest.mark.parametrize("value", [FREE, 7])
def test_maps_that_cannot_be_scored(value: int) -> None:
    bad = Raster(np.full((5, 5), value, np.int8), CELL)
    with pytest.raises(InputError, match=r"^estimate: "):
        map_accuracy(bad, room())
    with pytest.raises(InputError, match=r"^truth: "):
        map_accuracy(mapped(), bad)
    with pytest.raises(InputError, match=r"^truth: no wall that was seen"):
        map_accuracy(mapped(), room(), seen=np.array([[100.0, 100.0]]))


def twice_around(noise: float = 0.003) -> tuple[Recording, Trajectory]:
    """Two laps of 28 m within an empty room, a scan each 0.2 m."""
    corners = np.array([[2.0, 2.0], [10.0, 2.0], [10.0, 6.0], [2.0, 6.0], [2.0, 2.0]])
    lap = np.vstack([np.linspace(a, b, 40, endpoint=False) for a, b in pairwise(corners)])
    headings = np.repeat((0.0, np.pi / 2, np.pi, -np.pi / 2), 40)
    poses = np.tile(np.column_stack((lap, headings)), (2, 1))
    x, y, theta = np.split(poses, 3, axis=1)
    ranges = box_ranges(x, y, theta + ANGLES, (0.0, 0.0), (WIDE, TALL))
    ranges += np.random.default_rng(3).normal(0, noise, ranges.shape)
    stamps = 0.2 * np.arange(len(poses))
    lidar = LidarStream(stamps, ranges.astype(np.float32), ANGLES[0], ANGLES[1] - ANGLES[0], 0.1, 30.0)
    return Recording("room", Platform(), lidar=lidar, odometry=OdometryStream(stamps, poses)), Trajectory(stamps, poses)


@cache
def scored(x: float = 0.0, y: float = 0.0, noise: float = 0.003) -> MapConsistency:
    """The second lap is drawn that far aside [m]."""
    recording, truth = twice_around(noise)
    poses = truth.poses.copy()
    poses[len(poses) // 2 :, :2] += (x, y)
    return map_consistency(recording, Trajectory(truth.stamps, poses))


@pytest.mark.slow
def test_walls_drawn_once_are_as_thick_as_the_noise() -> None:
    score, noisy = scored(), scored(noise=0.01)
    assert score.thickness == pytest.approx(0.003, rel=0.3)
    assert score.twice == 0.0
    assert score.far < 0.02
    assert score.near < 0.03
    assert noisy.thickness == pytest.approx(0.01, rel=0.3)
    assert noisy.cells_per_metre > score.cells_per_metre


@pytest.mark.slow
def test_scans_that_draw_a_wall_twice_are_noticed() -> None:
    """In all but what the scans of one lap say."""
    scores = [scored(0.8 * shift, 0.6 * shift) for shift in (0.0, 0.05, 0.15, 0.3)]
    assert (np.diff([score.cells for score in scores]) > 0).all()
    assert (np.array([score.cells_per_metre for score in scores[1:]]) > 1.3 * scores[0].cells_per_metre).all()
    assert (np.diff([score.far or 0.0 for score in scores]) > 0).all()
    assert [score.near for score in scores] == pytest.approx([scores[0].near] * 4, rel=0.2)
    twice = [score.twice or 0.0 for score in scores]
    assert twice[0] == twice[1] == 0.0 < 0.05 < twice[2] < twice[3]
    # the length of the walls is that of what was seen
    assert [score.walls for score in scores] == pytest.approx([scores[0].walls] * 4, rel=0.25)


def test_the_other_side_of_a_wall_is_not_the_same_wall_drawn_twice() -> None:
    """Every other lap is driven beyond a wall of 20 cm: seen from both sides, drawn once each."""
    assert (scored(0.0, TALL + 0.2).twice or 0.0) < 0.05


def test_a_drive_that_comes_back_nowhere_has_no_far_distance() -> None:
    recording, truth = twice_around()
    few = replace(recording.lidar, stamps=recording.lidar.stamps[:30], ranges=recording.lidar.ranges[:30])
    score = map_consistency(Recording("wall", Platform(), lidar=few), Trajectory(truth.stamps[:30], truth.poses[:30]))
    assert score.far is score.twice is None


def test_scans_without_an_endpoint_draw_no_map() -> None:
    recording, truth = twice_around()
    empty = replace(recording.lidar, ranges=np.full_like(recording.lidar.ranges, np.inf))
    with pytest.raises(InputError, match="lidar: scans without an endpoint"):
        map_consistency(Recording("empty", Platform(), lidar=empty), truth)
