"""A robot that is carried elsewhere while it sees nothing: lost, and found again in its own map."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from slam_rooms import recorded, run, seen_from
from tile_pools import room_scan, thinned

from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.slam.filter.certainty import LocalisationState
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.mapping.tsdf import TsdfMaps
from moteslam.slam.registration.config import RegistrationConfig
from moteslam.slam.scan_records import Losses
from moteslam.slam.tsdf import filter as tsdf_filter
from moteslam.slam.tsdf.relocation import Relocation

pytestmark = pytest.mark.usefixtures("taichi")
CORNERS = [(-3, -2.5), (6, -2.5), (6, 1.0), (4.5, 3.5), (0.5, 3.5), (0.5, 2.6), (-3, 2.6), (-3, -2.5)]
ROOM = [*pairwise(CORNERS), ((3.5, -1.8), (4.6, -1.8)), ((3.5, -1.8), (3.5, -1.0)), ((-2, -2.5), (-2, -1.5))]
OTHER = [((-3, -5), (5.5, -4.2)), ((5.5, -4.2), (2.6, 3.8)), ((2.6, 3.8), (-1.2, 1.9)), ((-1.2, 1.9), (-3, -5))]
CARRIED = 130
ALONE = "backend.method=none"


def driven(scans: int, start: tuple[float, float, float]) -> np.ndarray:
    """Poses on a circle of 0.9 m from a place on."""
    steps = np.tile([0.08, 0.0, 0.08 / 0.9], (scans - 1, 1))
    return np.asarray(se2.compose(np.array(start), se2.accumulate(np.vstack((np.zeros(3), steps)))))


def carried(elsewhere: tuple[float, float, float], walls: list, *, scans: int = 120):
    """A recording of a robot that is set down elsewhere after ``CARRIED`` scans, and its true poses."""
    true = np.vstack((driven(CARRIED, (0.0, 0.0, 0.0)), driven(scans, elsewhere)))
    ranges = np.vstack((seen_from(true[:CARRIED], ROOM), seen_from(true[CARRIED:], walls)))
    ranges += np.random.default_rng(0).normal(0, 0.005, ranges.shape)
    return recorded(ranges, driven(CARRIED + scans, (0.0, 0.0, 0.0))), true


def occupied(drawn: Raster) -> set[tuple[int, int]]:
    """The occupied cells of a map, by their place in the world."""
    rows, columns = np.nonzero(drawn.values > 0)
    x, y, _ = np.array(drawn.origin) / drawn.cell_size
    return set(zip((columns + round(x)).tolist(), (rows + round(y)).tolist(), strict=True))


@pytest.mark.parametrize("method", ["none", "graph"])
def test_it_is_found_in_its_map_and_all_since_it_was_lost_with_it(method: str):
    recording, true = carried((3.6, 1.6, 2.5), ROOM)
    estimate = run(recording, f"backend.method={method}")
    states = estimate.diagnostics["state"]
    assert (states[:CARRIED] == LocalisationState.SURE).all()
    assert (states[CARRIED + 20 : CARRIED + 40] == LocalisationState.LOST).all()
    assert states[-1] == LocalisationState.SURE
    found = estimate.corrections[0].scan  # its own pose is still that of the map apart
    assert states[found] == LocalisationState.LOST
    assert states[found + 1] == LocalisationState.SURE
    off = se2.between(true, estimate.trajectory_final.poses)
    assert np.hypot(off[:, 0], off[:, 1]).max() < 0.05
    assert np.abs(off[:, 2]).max() < 0.03
    assert np.hypot(*(true - estimate.trajectory.poses)[-1, :2]) < 0.05  # online, too
    lost = [issue.message for issue in estimate.warnings if issue.code == "lost"]
    assert len(lost) == 1
    assert "until it is found" in lost[0]


def test_most_scans_lost_without_a_map_apart_are_told():
    assert [issue.count for issue in Losses().issues(np.array([0, 2, 2]))] == [2]
    assert not Losses().issues(np.array([0, 2]))


def test_in_a_room_that_it_has_never_seen_it_is_not_found():
    recording, _ = carried((0.4, -0.8, 1.0), OTHER)
    estimate = run(recording, ALONE)
    assert (estimate.diagnostics["state"][CARRIED + 20 :] == LocalisationState.LOST).all()
    lost = [issue.message for issue in estimate.warnings if issue.code == "lost"]
    assert [text.endswith("the map is that of the longer part") for text in lost] == [True]
    alone, _ = carried((0.4, -0.8, 1.0), ROOM, scans=1)
    before = run(alone, ALONE)
    walls, others = occupied(before.map), occupied(estimate.map)
    assert len(walls & others) > 0.9 * len(walls)
    assert len(others - walls) < 0.1 * len(walls)


def test_no_place_is_preferred_for_a_robot_that_was_carried_while_it_was_not_seen(monkeypatch: pytest.MonkeyPatch):
    """It stands, and after ten seconds it sees a room much like its own, half a metre aside and half turned round."""
    alike = [tuple((1.03 * x, 1.03 * y) for x, y in wall) for wall in ROOM]
    stand = np.repeat(driven(CARRIED, (0.0, 0.0, 0.0))[-1:], 15, axis=0)
    moved = se2.compose(stand[-1], (0.4, 0.5, 1.2))
    true = np.vstack((driven(CARRIED, (0.0, 0.0, 0.0)), stand, driven(60, tuple(moved.tolist()))))
    ranges = np.vstack((seen_from(true[: CARRIED + 15], ROOM), seen_from(true[CARRIED + 15 :], alike)))
    odometry = np.vstack((true[: CARRIED + 15], driven(60, tuple(stand[-1].tolist()))))
    recording = recorded(ranges, odometry)
    stamps = recording.lidar.stamps + 10.0 * (np.arange(len(true)) >= CARRIED + 15)
    recording = recording.replace(lidar=replace(recording.lidar, stamps=stamps))
    asked = []

    def spied(*args, carried: bool, **kwargs) -> Relocation:
        asked.append(carried)
        return Relocation(*args, carried=carried, **kwargs)

    monkeypatch.setattr(tsdf_filter, "Relocation", spied)
    run(recording, ALONE)
    assert asked == [True]


@pytest.mark.filterwarnings("error")
def test_no_endpoints_are_found_nowhere():
    path = np.column_stack((np.linspace(-2, 2, 9), np.zeros((9, 2))))
    maps = TsdfMaps(TsdfConfig())
    maps.draw(path, [thinned(room_scan(pose)) for pose in path])
    looking = Relocation(maps, 0, path, RegistrationConfig(), begin=np.zeros(3), carried=True)
    none = np.empty((0, 2), np.float32)
    assert all(looking.search(np.array((x, 0.0, 0.0)), none) is None for x in np.arange(0, 9, 0.5))


@pytest.mark.parametrize(
    ("carried", "off", "known"), [(False, 0.0, True), (True, 0.0, False), (False, 0.02, True), (False, 0.2, False)]
)
def test_a_robot_that_has_drifted_is_found_near_where_it_was_tracked_to(carried: bool, off: float, known: bool):
    """Its room looks the same turned half round: who was carried may stand either way, who drifted is not turned.

    But not where a share of the endpoints is 0.35 m off.
    """
    path = np.column_stack((np.linspace(-2, 2, 9), np.zeros((9, 2))))
    maps = TsdfMaps(TsdfConfig())
    maps.draw(path, [thinned(room_scan(pose)) for pose in path])
    drift = np.array((3.0, -2.0, 0.2))
    looking = Relocation(maps, 0, path, RegistrationConfig(), begin=drift, carried=carried)
    found = []
    for x in np.arange(-2, 2.1, 0.4):
        true = np.array((x, 0.3, 0.0))
        points = room_scan(true)
        nearer = np.random.default_rng(0).random(len(points)) < off
        points[nearer] *= 1 - 0.35 / np.hypot(*points[nearer].T)[:, None]
        frame = looking.search(np.asarray(se2.compose(drift, true)), points)
        if frame is not None:
            found.append((x, np.asarray(se2.compose(frame, drift))))
    assert bool(found) == known
    if known:
        assert found[0][0] < 1.7  # two searches, two metres and three from where it was lost
        np.testing.assert_allclose(found[0][1], 0.0, atol=0.02)
