"""What is doubtful where a trajectory is compared with another one: clocks, units, axes, few partners."""

from __future__ import annotations

import numpy as np

from moteslam.eval.metrics.ate import AteResult
from moteslam.eval.metrics.clock import ClockOffset
from moteslam.eval.metrics.space import in_space
from moteslam.robot.se2 import transform_points, umeyama
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue

SMALL, LARGER = 0.1, 50.0
"""Errors and sizes below this [m], and ratios of sizes below that, are no other unit."""
AXES = np.deg2rad(30.0)
"""Orientations that differ by more than this throughout [rad] are of other axes."""
FEW = 0.5
"""Where less than this share of the shorter trajectory's poses has a partner, the two may not belong together."""


def said(offset: ClockOffset) -> str:
    """An offset of the clocks in words, with the option that takes it."""
    instead = "" if offset.before is None else f" in place of {offset.before:.4f} m"
    fits = f"moved by {offset.seconds:+.3f} s the estimate fits with an ATE of {offset.rmse:.4f} m{instead}"
    return f"{fits}: its clock seems to be another one (--time-offset {offset.seconds:.3f})"


def of_reading(estimate: Trajectory, reference: Trajectory) -> tuple[Issue, ...]:
    """What was assumed when both were read; the plane of motion matters where they are compared in x and y."""
    left_out = {"out-of-plane"} if in_space(estimate, reference) else set()
    issues = dict.fromkeys((*estimate.warnings, *reference.warnings))
    return tuple(issue for issue in issues if issue.code not in left_out)


def of_shape(ate: AteResult) -> tuple[Issue, ...]:
    """That one path is far larger than the other or its mirror image, or that the axes of both bodies differ."""
    there, true = ate.aligned[:, :2], ate.reference[:, :2]
    size = float(np.linalg.norm(there.std(axis=0)) / max(float(np.linalg.norm(true.std(axis=0))), SMALL))
    if ate.rmse > SMALL and not 1 / LARGER < size < LARGER:
        return (Issue("sizes-differ", f"the estimate is {size:.3g} times as large as the reference: other units?"),)
    mirrored = there * (1.0, -1.0)
    off = transform_points(umeyama(mirrored, true), mirrored) - true
    if ate.motion is None and ate.rmse > SMALL and float(np.sqrt(np.square(off).sum(axis=1).mean())) < ate.rmse / 5:
        return (
            Issue("mirrored", "the estimate fits the reference as its mirror image: y or turns of the wrong sign?"),
        )
    if ate.motion is None or ate.rotation_errors is None or np.median(ate.rotation_errors) < AXES:
        return ()
    if ate.rotation_errors.std() > 0.2 * AXES:
        return ()
    degrees = np.rad2deg(float(np.median(ate.rotation_errors)))
    why = f"orientations differ by {degrees:.0f} degrees throughout: other axes of the body, or a mirrored path"
    text = f"{why}; errors of rotation and relative errors hold that"
    return (Issue("body-axes", text, len(ate.stamps)),)


def few_matched(matched: int, shorter: int, what: str, question: str) -> tuple[Issue, ...]:
    """The issue that few of the shorter one's stamps have a partner, if they are few."""
    if matched >= FEW * shorter:
        return ()
    return (Issue("few-matched", f"{matched} of {shorter} {what} have a partner: {question}", matched),)
