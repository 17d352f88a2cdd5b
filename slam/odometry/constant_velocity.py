"""The motion of a step that nothing measured: the robot goes on at the velocity of the step before."""

from __future__ import annotations

from moteslam.robot.se2 import Pose


def extrapolated(motion: Pose, seconds: float, dt: float, *, most: float = 10.0) -> Pose:
    """The motion of a step at the velocity of the step before.

    Args:
        motion: of the step before, as filtered.
        seconds: that it took.
        dt: of this step [s].
        most: the motion is extrapolated to at most this many times as long: a longer gap is likelier a wrong stamp,
            or a robot that has long stopped.

    Returns:
        it scaled by the ratio of the times where both are above 0; else the same motion, as in logs whose scans
        share stamps.
    """
    if seconds <= 0 or dt <= 0:
        return motion
    share = min(dt / seconds, most)
    x, y, turn = motion
    return x * share, y * share, turn * share
