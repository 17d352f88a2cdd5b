"""Parameters that particle filters share: the update policy, and KLD sampling."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from moteslam.robot.tables import NotNegative, Number, Positive, Section, Truth, Whole


class UpdateConfig(Section):
    """The update policy: a scan is used when the robot has moved this far, turned this much, or this time has passed
    since the last that was; the poses of scans between follow the motion. With zeros every scan is used.
    """

    distance: NotNegative = 0.0
    """Distance since the last update [m]."""
    rotation: NotNegative = 0.0
    """Sum of the absolute turns since [rad]."""
    interval: Positive = 1e9
    """Time since [s]."""


class KldConfig(Section):
    """KLD sampling: as many particles as the posterior needs (Fox 2003; Probabilistic Robotics, table 8.4).

    The number changes where particles are resampled, and there alone.
    """

    enabled: Truth = False
    """Adapt the number of particles; `particles` is then the largest number, and the first."""
    epsilon: Positive = 0.05
    """Kullback-Leibler distance that is allowed between the particles and the posterior, over the bins."""
    delta: Annotated[Number, Field(gt=0, lt=1)] = 0.01
    """Probability that it is exceeded."""
    bin_size: Positive = 0.1
    """Of the bins in x and in y [m]."""
    bin_angle: Positive = 0.05
    """Of the bins in the heading [rad]."""
    least: Annotated[Whole, Field(ge=1)] = 10
    """Never fewer particles than these; `particles` wins if it is smaller."""
