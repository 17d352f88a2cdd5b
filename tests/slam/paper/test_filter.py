"""The paper's filter a step at a time: what it reports, whom a particle descends from, where the map's rays start."""

from collections.abc import Iterator

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.kernels.matching import match_poses
from moteslam.slam.inputs.step import Step, steps
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.paper.config import PaperFilterConfig
from moteslam.slam.paper.filter import PaperFilter
from moteslam.slam.run import SlamSession
from moteslam.slam.settings import resolve_config

pytestmark = pytest.mark.usefixtures("taichi")


def config_of(*settings: str) -> PaperFilterConfig:
    config = resolve_config("paper", ["particles=20", *settings])
    assert isinstance(config, PaperFilterConfig)
    return config


def room_steps(config: PaperFilterConfig) -> Iterator[Step]:
    return steps(synchronise(circled_room(scans=40)[0], config.sync))


def test_the_reported_score_is_the_best_particles_in_the_map_before_the_scan():
    config = config_of()
    paper = PaperFilter(config, 0)
    updates, unlike_the_first = 0, 0
    for step in room_steps(config):
        occupied, origin = paper.grid.occupied.copy(), paper.grid.origin
        result = paper.step(step)
        if not result.updated or not step.index:
            assert result.score == 0
            continue
        cell_size, poses, here = paper.grid.cell_size, paper.history.last, np.zeros(1)
        found = match_poses(occupied, origin, cell_size, poses, step.points, offsets_xy=here, offsets_theta=here)
        scores = found.scores
        # resampled after every update, the weights are equal before each: the best particle is that of the best score
        assert result.score == scores[paper.best_particle] == scores.max()
        updates += 1
        unlike_the_first += result.score != scores[0]
    assert updates > 20
    assert unlike_the_first > updates / 2


def test_a_particles_path_leads_through_the_particle_it_was_drawn_from():
    recording, _ = circled_room(scans=40)
    session = SlamSession(recording, config_of(), seed=0)
    after_resampling = [update.poses.copy() for update in session if update.resampled]
    assert len(after_resampling) > 20
    paths = session.estimate().particle_paths
    np.testing.assert_array_equal(paths[:, -2], after_resampling[-2])
    ancestors = [len(np.unique(poses, axis=0)) for poses in paths.swapaxes(0, 1)]
    assert ancestors == sorted(ancestors)  # lines merge backwards in time, and never part again
    assert ancestors[1] < len(paths) / 2


def test_the_maps_rays_start_at_the_lidar():
    paper = PaperFilter(config_of(), 0)
    lidar = np.array((1.025, 1.025))  # the middle of a cell
    wall = np.array([(3.025, y) for y in np.linspace(0.925, 1.125, 21)], np.float32)
    paper.step(Step(0, 0.0, 0.0, np.zeros(3), True, wall, lidar))

    def at(*places: tuple[float, float]) -> np.ndarray:
        return paper.occupancy().values_at(np.array(places), outside=0.0)

    assert at((3.025, 1.025)) > 0
    assert (at(*((x, 1.025) for x in (1.225, 1.625, 2.025, 2.425, 2.825))) < 0).all()
    # nothing is known of what lies between the robot's origin and the lidar, or beside the beams
    assert not at((0.025, 0.025), (0.525, 0.175), (0.525, 0.525), (0.725, 1.025), (0.925, 0.325), (1.525, 0.525)).any()
