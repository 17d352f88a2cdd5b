"""The TSDF filter a step at a time: weights and score are those of its proposals, the odometry is calibrated."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from slam_rooms import circled_room

from moteslam.robot import se2
from moteslam.slam.inputs.step import steps
from moteslam.slam.inputs.synchronise import synchronise
from moteslam.slam.run import run_slam
from moteslam.slam.settings import resolve_config
from moteslam.slam.tsdf import filter as tsdf_filter
from moteslam.slam.tsdf.config import TsdfFilterConfig
from moteslam.slam.tsdf.filter import TsdfFilter
from moteslam.slam.tsdf.proposal import Proposal

pytestmark = pytest.mark.usefixtures("taichi")


def config_of(*settings: str) -> TsdfFilterConfig:
    config = resolve_config("default", [*settings])
    assert isinstance(config, TsdfFilterConfig)
    return config


@pytest.fixture
def proposals(monkeypatch: pytest.MonkeyPatch) -> list[Proposal]:
    """Every proposal that a filter makes while the test runs."""
    made: list[Proposal] = []
    propose = tsdf_filter.propose

    def watched(*arguments: Any, **options: Any) -> Proposal:
        made.append(propose(*arguments, **options))
        return made[-1]

    monkeypatch.setattr(tsdf_filter, "propose", watched)
    return made


def test_weights_are_the_product_of_the_proposals_likelihoods_and_the_score_is_the_best_particles(
    proposals: list[Proposal],
):
    config = config_of("particles=12", "resample_below=0")
    tsdf = TsdfFilter(config, 0)
    product, unlike_the_first = np.zeros(12), 0
    for step in steps(synchronise(circled_room(scans=40)[0], config.sync)):
        made = len(proposals)
        result = tsdf.step(step)
        if len(proposals) == made:
            assert result.score == 0
            continue
        assert len(proposals) == made + 1
        product += proposals[-1].log_likelihood
        np.testing.assert_allclose(tsdf.weights.values, np.exp(product) / np.exp(product).sum(), rtol=1e-9)
        best = int(product.argmax())
        assert tsdf.best_particle == best
        assert result.score == proposals[-1].likelihoods[best]
        unlike_the_first += result.score != proposals[-1].likelihoods[0]
    assert len(proposals) > 15
    assert np.ptp(product) > 0.1
    assert unlike_the_first > 5


def test_where_the_scans_stop_the_odometry_is_followed_as_it_was_calibrated():
    """The gyro turns 3 % too far. Two thirds of the drive calibrate it; then the robot is blind for a third of it."""
    recording, true = circled_room(drift=0.03)
    lidar, seen = recording.lidar, 80
    assert lidar is not None
    dark = np.where(np.arange(len(lidar))[:, None] < seen, lidar.ranges, np.float32(np.inf))
    recording = recording.replace(lidar=replace(lidar, ranges=dark))

    def turned_too_far(*settings: str) -> float:
        poses = run_slam(recording, config_of("particles=5", *settings), seed=0).trajectory.poses
        off = np.diff(poses[seen - 1 :, 2]) - np.diff(true[seen - 1 :, 2])
        return float(se2.wrap(off).sum())

    uncalibrated = turned_too_far("calibration.enabled=false")
    assert uncalibrated == pytest.approx(0.03 * 40 * 2 * np.pi / 60, abs=0.01)
    assert abs(turned_too_far()) < uncalibrated / 4
