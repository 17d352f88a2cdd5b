"""Parameters of synchronisation and of thinning."""

from typing import Annotated, Literal

from pydantic import Field

from moteslam.robot.values import NotNegative, Positive, Section, Share, Truth, Whole


class SyncConfig(Section):
    """Synchronisation of lidar, wheels and gyro (section III.A of the paper)."""

    # `nearest` takes the reading nearest in time, as the paper does; `interpolate` the value between the two readings
    # around it
    method: Literal["nearest", "interpolate"] = "interpolate"
    low_pass_hz: NotNegative = 0.0  # Cut-off of the causal low-pass on the yaw rate [Hz]; 0 turns it off
    kinematics: Literal["euler", "arc"] = "arc"  # `euler` is equation III.1, `arc` the exact arc
    # Move every beam by the motion of the robot since the first beam of its scan, by the odometry. Scans stay as they
    # are where a recording does not say how long a sweep takes, and where the odometry jumps.
    deskew: Truth = True
    max_speed: Positive = 4.0  # Odometry has jumped only in steps faster than this [m/s] or than `max_turn_rate`
    max_turn_rate: Positive = 4.0  # See `max_speed` [rad/s]
    # Odometry has jumped only in steps this many times as long as the 90th percentile of the latest 1000
    jump_factor: Positive = 10.0
    # Odometry has jumped only in steps longer than this [m]: registration corrects shorter ones
    min_jump_distance: NotNegative = 0.2
    # Odometry has jumped only in steps that turn by more than this [rad], where it is the turn that is too fast
    min_jump_rotation: NotNegative = 0.2
    # While odometry has not moved, a range has changed where it differs by more than this from the first scan [m]
    same_range: Positive = 0.05
    # The robot has left where it began when more than this share of the ranges has changed: people who walk by change
    # fewer. Odometry that has not moved by then is no measurement.
    moved_share: Share = 0.2
    # Endpoints that keep their bearing and range while the odometry moves are no walls: what travels with the robot is
    # left out, and wheels that spin on the spot are found
    travelling: Truth = True


class ThinningConfig(Section):
    """How neighbouring endpoints are averaged, and which neighbours see the same surface."""

    spacing: Positive = 0.02  # Endpoints nearer than this to each other are averaged to one point [m]
    # While a scan has more than `max_points` points, the spacing is raised step by step, up to this [m]
    max_spacing: Positive = 0.06
    # Points of a thinned scan that `max_spacing` aims at: what a scan costs and weighs then depends little on the
    # number of beams
    max_points: Annotated[Whole, Field(ge=8, le=100_000)] = 200
    gap: Positive = 0.3  # A surface joins neighbouring points up to this far apart [m], plus `gap_from_range`
    gap_from_range: NotNegative = 0.03  # Added to `gap` for every metre of range [m/m]
