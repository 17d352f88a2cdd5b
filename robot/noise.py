"""What the sensors of a robot get wrong, as figures: ``[noise]`` of a platform and of a scenario.

A figure that is left out is an error that is not there: ``Noise()`` has perfect sensors. The figures of the bundled
robots stand in ``robot/platforms`` with their sources.
"""

from typing import Annotated, Self

from pydantic import Field, model_validator

from moteslam.robot.values import NotNegative, Number, Positive, Section, Share

Seconds = Annotated[Number, Field(ge=0, le=60)]
SmallAngle = Annotated[Number, Field(ge=0, le=0.3)]
Factor = Annotated[Number, Field(ge=0.5, le=2)]


class ClockNoise(Section):
    """How a host stamps the readings of a device that itself ticks steadily.

    On the UCSD robot the counts do not follow the intervals between the stamps: the jitter is in the stamping. So a
    stamp is the time of the reading plus a delay; readings that were held up come out in a burst.
    """

    jitter: NotNegative = 0.0  # scale of the usual, half-normal delay [s]
    late: Share = 0.0  # probability that a reading is held up
    late_delay: NotNegative = 0.0  # longest such delay [s], uniform from 0
    burst_interval: NotNegative = 0.0  # shortest interval between two stamps [s]
    rate_error: NotNegative = 0.0  # standard deviation of the device's rate, relative, drawn once a recording
    offset: Annotated[Number, Field(ge=-10, le=10)] = 0.0  # that all of its stamps are too late [s]
    drift: Annotated[Number, Field(ge=-0.01, le=0.01)] = 0.0  # by how much the offset grows [s/s]
    offset_error: Annotated[Number, Field(ge=0, le=1)] = 0.0  # deviation of a further one, drawn once a recording [s]
    lost: Annotated[Number, Field(ge=0, lt=1)] = 0.0  # share of its messages that never arrive
    # how long after the wheel counters its first reading is taken, and before them its last, at least and at most [s]
    begins: tuple[Seconds, Seconds] = (0.0, 0.0)
    ends: tuple[Seconds, Seconds] = (0.0, 0.0)

    @model_validator(mode="after")
    def _are_spans(self) -> Self:
        for key, (least, most) in (("begins", self.begins), ("ends", self.ends)):
            if least > most:
                raise ValueError(f"{key} of {least:g} and {most:g} s, expected the shorter time first")
        return self


class LidarNoise(Section):
    """What is wrong with ranges."""

    range_noise: Annotated[Number, Field(ge=0, le=1)] = 0.0  # standard deviation of a range at the sensor [m]
    range_noise_per_metre: Share = 0.0  # how it grows with the range [m/m]
    outliers: Share = 0.0  # of the beams, with a range that is worse: two things in one beam, another height, mist
    outlier_noise: NotNegative = 0.0  # standard deviation that comes on top of theirs [m]
    dropout: Share = 0.0  # probability that a beam gives no usable reading (nan)
    resolution: Annotated[Number, Field(ge=0, le=1)] = 0.0  # ranges are rounded to this [m]; 0 for not at all
    divergence: Annotated[Number, Field(ge=0, le=0.1)] = 0.0  # angle that a beam is wide [rad]; 0 for a line
    mixed: Share = 0.5  # with a divergence, of the beams on an edge, with a range in between
    # largest distance between near and far side of an edge at which they melt into one echo [m]; beyond it, one of the
    # two is measured
    pulse: NotNegative = 1.0
    false_return: Share = 0.0  # of the beams, which meet rain, dust or snow
    # mean distance of such an echo [m] (exponential: short readings of table 6.1 of Probabilistic Robotics)
    false_scale: Positive = 3.0
    # standard deviations of what is drawn once a recording: how much too long all ranges are [m] and relative, where
    # the lidar stands, forward and to the left [m], how it is turned [rad], its roll and pitch [rad], by which beams
    # that end on the floor are lost
    range_bias: Annotated[Number, Field(ge=0, le=1)] = 0.0
    range_scale_error: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    mount_error: Annotated[Number, Field(ge=0, le=1)] = 0.0
    mount_yaw_error: SmallAngle = 0.0
    mount_tilt_error: SmallAngle = 0.0
    clock: ClockNoise = ClockNoise()


class EncoderNoise(Section):
    """Wheels that are not what the data sheet says, on a floor that is not even."""

    # relative errors that are drawn once a recording: of all the wheels' radius, of each one's, of the effective track
    scale_error: NotNegative = 0.0
    radius_error: NotNegative = 0.0
    track_error: NotNegative = 0.0
    slip: NotNegative = 0.0  # standard deviation of each side's momentary slip, relative to its travel
    slip_time: Positive = 0.5  # correlation time of the slip [s]
    # what the true radii of the FR, FL, RR, RL wheel are times what they should be
    radius_factors: tuple[Factor, Factor, Factor, Factor] = (1.0, 1.0, 1.0, 1.0)
    missed: Share = 0.0  # of the ticks, which a counter misses
    bursts: Annotated[Number, Field(ge=0, le=600)] = 0.0  # of slip, a minute, of one side at a time
    burst_slip: Annotated[Number, Field(ge=-1, le=10)] = 0.5  # how much more its wheels turn then than travel, relative
    burst_time: Positive = 0.4  # how long a burst lasts, on average (exponential) [s]
    clock: ClockNoise = ClockNoise()


class ImuNoise(Section):
    """What is wrong with a gyro and an accelerometer."""

    gyro_noise: NotNegative = 0.0  # standard deviation of an angular velocity at rest [rad/s]
    # of that noise with itself one and two readings later, where the device filters its readings
    gyro_correlation: tuple[Number, Number] = (0.0, 0.0)
    gyro_bias: NotNegative = 0.0  # size of the yaw rate's bias [rad/s], either sign
    gyro_bias_spread: NotNegative = 0.0  # its standard deviation from one recording to another, relative
    gyro_bias_walk: NotNegative = 0.0  # random walk of the bias [rad/s per root second]
    gyro_scale_error: NotNegative = 0.0  # of the angular velocities, relative, drawn once a recording
    accelerometer_noise: NotNegative = 0.0  # standard deviation at rest [g]
    accelerometer_bias: NotNegative = 0.0  # standard deviation of each axis, drawn once a recording [g]
    vibration: NotNegative = 0.0  # standard deviation of the horizontal accelerations at 1 m/s [g]
    tilting: NotNegative = 0.0  # standard deviation of the roll and pitch rates at 1 m/s [rad/s]
    clock: ClockNoise = ClockNoise()

    @model_validator(mode="after")
    def _is_a_correlation(self) -> Self:
        one, two = self.gyro_correlation
        if not (-1 < one < 1 and 2 * one**2 - 1 < two < 1):
            expected = "two numbers between -1 and 1 that some noise has: the second above 2 first^2 - 1"
            raise ValueError(f"gyro_correlation of {one:g} and {two:g}, expected {expected}")
        return self


class DriveNoise(Section):
    """What a body does that its encoders and a flat map do not show."""

    # force against the motion over the weight: the wheels turn further than the robot drives
    rolling_resistance: Annotated[Number, Field(ge=0, le=0.2)] = 0.0
    # of the centre of mass above the floor [m]: braking and bends shift the load between the wheels, and with it what
    # each of them holds
    mass_height: Annotated[Number, Field(ge=0, le=2)] = 0.0
    sway: SmallAngle = 0.0  # roll and pitch for an acceleration [rad per m/s^2]
    shake: SmallAngle = 0.0  # standard deviation of roll and pitch at 1 m/s [rad]; in proportion to the speed


class Surroundings(Section):
    """What buildings have and plans do not: walls that are not flat, things along them, surfaces that swallow light."""

    relief: Annotated[Number, Field(ge=0, le=0.2)] = 0.0  # deviation of a wall's distance from its straight line [m]
    relief_length: Annotated[Number, Field(ge=0.02, le=10)] = 0.1  # over which that changes [m]
    clutter: Annotated[Number, Field(ge=0, le=5)] = 0.0  # things along the walls, on either side, a metre [1/m]
    clutter_depth: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.15  # how far they stand out, on average [m]
    clutter_width: Annotated[Number, Field(ge=0.01, le=3)] = 0.3  # how wide they are, on average [m]
    # from where the last echo of a surface comes that is met square on, the median over the surfaces [m]; it shrinks
    # aslant (see the materials of a world). 0 for any distance
    reach: NotNegative = 0.0
    reach_spread: Annotated[Number, Field(ge=0, le=3)] = 0.0  # deviation of its logarithm over the surfaces


class Noise(Section):
    """All that sensors, drive and surroundings add to a perfect world."""

    # times the slip, scale, radius and track errors of the encoders and the noise, bias and scale error of the gyro
    odometry_scale: NotNegative = 1.0
    lidar: LidarNoise = LidarNoise()
    encoders: EncoderNoise = EncoderNoise()
    imu: ImuNoise = ImuNoise()
    drive: DriveNoise = DriveNoise()
    surroundings: Surroundings = Surroundings()
