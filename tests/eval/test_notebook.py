"""What a notebook shows of a run and its scores: one line each, and a picture of the estimate."""

from __future__ import annotations

import cv2
import numpy as np

import moteslam


def test_results_are_shown_in_one_line(run, simulation) -> None:
    estimate, _ = run
    assert repr(estimate).startswith(f"Estimate({estimate.name!r}, method {estimate.config.method}, seed ")
    ate = moteslam.absolute_trajectory_error(estimate.trajectory, simulation.truth)
    rpe = moteslam.relative_pose_error(estimate.trajectory, simulation.truth)
    assert repr(ate) == (
        f"AteResult({ate.pairs} poses, RMSE {ate.rmse:.3f} m and {np.rad2deg(ate.rotation.rmse):.2f} deg)"
    )
    for value in (estimate, simulation, rpe):
        assert len(repr(value)) < 200
        assert "array" not in repr(value)


def test_an_estimate_is_shown_as_its_map_and_path(run) -> None:
    estimate, _ = run
    image = cv2.imdecode(np.frombuffer(estimate._repr_png_(), np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    assert max(image.shape) <= 800
    slam = (abs(image.astype(int) - (0xB2, 0x72, 0x00)) < 20).all(axis=2)
    assert slam.any()
