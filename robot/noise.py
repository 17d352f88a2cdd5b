"""What the sensors of a robot get wrong, as figures: ``[noise]`` of a platform and of a scenario.

A figure that is left out is an error that is not there: ``Noise()`` has perfect sensors. The figures of the bundled
robots stand in ``robot/platforms`` with their sources.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from moteslam.robot.tables import NotNegative, Number, Positive, Section, Share

Seconds = Annotated[Number, Field(ge=0, le=60)]
SmallAngle = Annotated[Number, Field(ge=0, le=0.3)]
Factor = Annotated[Number, Field(ge=0.5, le=2)]


class ClockNoise(Section):
    """How a host stamps the readings of a device that itself ticks steadily.

    On the UCSD robot the counts do not follow the intervals between the stamps: the jitter is in the stamping. So a
    stamp is the time of the reading plus a delay; readings that were held up come out in a burst.

    Attributes:
        jitter: scale of the usual, half-normal delay [s].
        late: probability that a reading is held up.
        late_delay: longest such delay [s], uniform from 0.
        burst_interval: shortest interval between two stamps [s].
        rate_error: standard deviation of the device's rate, relative, drawn once a recording.
        offset: that all of its stamps are too late [s]; negative: too early.
        drift: by how much the offset grows [s/s].
        offset_error: standard deviation of a further offset, drawn once a recording [s].
        lost: share of its messages that never arrive.
        begins: how long after the wheel counters its first reading is taken, at least and at most [s].
        ends: how long before them its last one is, at least and at most [s].
    """

    jitter: NotNegative = 0.0
    late: Share = 0.0
    late_delay: NotNegative = 0.0
    burst_interval: NotNegative = 0.0
    rate_error: NotNegative = 0.0
    offset: Annotated[Number, Field(ge=-10, le=10)] = 0.0
    drift: Annotated[Number, Field(ge=-0.01, le=0.01)] = 0.0
    offset_error: Annotated[Number, Field(ge=0, le=1)] = 0.0
    lost: Annotated[Number, Field(ge=0, lt=1)] = 0.0
    begins: tuple[Seconds, Seconds] = (0.0, 0.0)
    ends: tuple[Seconds, Seconds] = (0.0, 0.0)

    @model_validator(mode="after")
    def _are_spans(self) -> ClockNoise:
        for key, (least, most) in (("begins", self.begins), ("ends", self.ends)):
            if least > most:
                raise ValueError(f"{key} of {least:g} and {most:g} s, expected the shorter time first")
        return self


class LidarNoise(Section):
    """What is wrong with ranges.

    Attributes:
        range_noise: standard deviation of a range at the sensor [m].
        range_noise_per_metre: how it grows with the range [m/m].
        outliers: share of the beams whose range is that much worse: two things in one beam, another height, mist.
        outlier_noise: standard deviation that comes on top of theirs [m].
        dropout: probability that a beam gives no usable reading (``nan``).
        resolution: ranges are rounded to this [m]; 0 for not at all.
        divergence: the angle that a beam is wide, in the scan's plane [rad]; 0 for a line.
        mixed: with a divergence, share of the beams on an edge that measure a range in between.
        pulse: largest distance between near and far side of an edge at which they melt into one echo [m]; beyond it,
            one of the two is measured.
        false_return: share of the beams that meet rain, dust or snow.
        false_scale: mean distance of such an echo [m] (exponential, the short readings of table 6.1 of Probabilistic
            Robotics).
        range_bias: standard deviation of what all ranges are too long by, drawn once a recording [m].
        range_scale_error: of all ranges, relative, drawn once a recording.
        mount_error: standard deviation of where the lidar stands, forward and to the left, drawn once a recording [m].
        mount_yaw_error: of how it is turned [rad].
        mount_tilt_error: of its roll and pitch [rad]: beams that end on the floor are lost.
        clock: of the scans.
    """

    range_noise: NotNegative = 0.0
    range_noise_per_metre: NotNegative = 0.0
    outliers: Share = 0.0
    outlier_noise: NotNegative = 0.0
    dropout: Share = 0.0
    resolution: NotNegative = 0.0
    divergence: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    mixed: Share = 0.5
    pulse: NotNegative = 1.0
    false_return: Share = 0.0
    false_scale: Positive = 3.0
    range_bias: Annotated[Number, Field(ge=0, le=1)] = 0.0
    range_scale_error: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    mount_error: Annotated[Number, Field(ge=0, le=1)] = 0.0
    mount_yaw_error: SmallAngle = 0.0
    mount_tilt_error: SmallAngle = 0.0
    clock: ClockNoise = ClockNoise()


class EncoderNoise(Section):
    """Wheels that are not what the data sheet says, on a floor that is not even.

    Attributes:
        scale_error: of all the wheels' radius, relative, drawn once a recording.
        radius_error: of each wheel's radius, relative, drawn once a recording.
        track_error: of the effective track, relative, drawn once a recording.
        slip: standard deviation of each side's momentary slip, relative to its travel.
        slip_time: correlation time of the slip [s].
        radius_factors: what the true radii of the FR, FL, RR, RL wheel are times what they should be.
        missed: share of the ticks that a counter misses.
        bursts: slip bursts a minute, of one side at a time.
        burst_slip: how much more the wheels of that side turn in a burst than they travel, relative.
        burst_time: how long a burst lasts, on average (exponential) [s].
        clock: of the readings.
    """

    scale_error: NotNegative = 0.0
    radius_error: NotNegative = 0.0
    track_error: NotNegative = 0.0
    slip: NotNegative = 0.0
    slip_time: Positive = 0.5
    radius_factors: tuple[Factor, Factor, Factor, Factor] = (1.0, 1.0, 1.0, 1.0)
    missed: Share = 0.0
    bursts: Annotated[Number, Field(ge=0, le=600)] = 0.0
    burst_slip: Annotated[Number, Field(ge=-1, le=10)] = 0.5
    burst_time: Positive = 0.4
    clock: ClockNoise = ClockNoise()


class ImuNoise(Section):
    """What is wrong with a gyro and an accelerometer.

    Attributes:
        gyro_noise: standard deviation of an angular velocity at rest [rad/s].
        gyro_correlation: of that noise with itself one and two readings later, where the device filters its readings.
        gyro_bias: size of the yaw rate's bias [rad/s], either sign.
        gyro_bias_spread: its standard deviation from one recording to another, relative.
        gyro_bias_walk: random walk of the bias [rad/s per root second].
        gyro_scale_error: of the angular velocities, relative, drawn once a recording.
        accelerometer_noise: standard deviation at rest [g].
        accelerometer_bias: standard deviation of each axis, drawn once a recording [g].
        vibration: standard deviation of the horizontal accelerations at 1 m/s [g].
        tilting: standard deviation of the roll and pitch rates at 1 m/s [rad/s].
        clock: of the readings.
    """

    gyro_noise: NotNegative = 0.0
    gyro_correlation: tuple[Number, Number] = (0.0, 0.0)
    gyro_bias: NotNegative = 0.0
    gyro_bias_spread: NotNegative = 0.0
    gyro_bias_walk: NotNegative = 0.0
    gyro_scale_error: NotNegative = 0.0
    accelerometer_noise: NotNegative = 0.0
    accelerometer_bias: NotNegative = 0.0
    vibration: NotNegative = 0.0
    tilting: NotNegative = 0.0
    clock: ClockNoise = ClockNoise()

    @model_validator(mode="after")
    def _is_a_correlation(self) -> ImuNoise:
        one, two = self.gyro_correlation
        if not (-1 < one < 1 and 2 * one**2 - 1 < two < 1):
            raise ValueError(
                f"gyro_correlation of {one:g} and {two:g}, expected two numbers between -1 and 1 that some noise has: "
                "the second above 2 first^2 - 1"
            )
        return self


class DriveNoise(Section):
    """What a body does that its encoders and a flat map do not show.

    Attributes:
        rolling_resistance: force against the motion over the weight: the wheels turn further than the robot drives.
        mass_height: of the centre of mass above the floor [m]: braking and bends shift the load between the wheels,
            and with it what each of them holds.
        sway: roll and pitch for an acceleration [rad per m/s^2].
        shake: standard deviation of roll and pitch at 1 m/s [rad]; in proportion to the speed.
    """

    rolling_resistance: Annotated[Number, Field(ge=0, le=0.2)] = 0.0
    mass_height: Annotated[Number, Field(ge=0, le=2)] = 0.0
    sway: SmallAngle = 0.0
    shake: SmallAngle = 0.0


class Surroundings(Section):
    """What buildings have and plans do not: walls that are not flat, things along them, surfaces that swallow light.

    Attributes:
        relief: standard deviation of a wall's distance from its straight line [m].
        relief_length: over which that changes [m].
        clutter: things that stand along the walls, on either side, a metre [1/m].
        clutter_depth: how far they stand out, on average [m].
        clutter_width: how wide they are, on average [m].
        reach: from where the last echo of a surface comes that is met square on, the median over the surfaces [m]; it
            shrinks aslant (see the materials of a world). 0 for any distance.
        reach_spread: standard deviation of its logarithm over the surfaces.
    """

    relief: Annotated[Number, Field(ge=0, le=0.2)] = 0.0
    relief_length: Annotated[Number, Field(ge=0.02, le=10)] = 0.1
    clutter: Annotated[Number, Field(ge=0, le=5)] = 0.0
    clutter_depth: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.15
    clutter_width: Annotated[Number, Field(ge=0.01, le=3)] = 0.3
    reach: NotNegative = 0.0
    reach_spread: Annotated[Number, Field(ge=0, le=3)] = 0.0


class Noise(Section):
    """All that sensors, drive and surroundings add to a perfect world.

    Attributes:
        odometry_scale: multiplies the slip, scale, radius and track errors of the encoders and the noise, bias and
            scale error of the gyro.
        lidar, encoders, imu: of each sensor.
        drive: of the body.
        surroundings: of the building.
    """

    odometry_scale: NotNegative = 1.0
    lidar: LidarNoise = LidarNoise()
    encoders: EncoderNoise = EncoderNoise()
    imu: ImuNoise = ImuNoise()
    drive: DriveNoise = DriveNoise()
    surroundings: Surroundings = Surroundings()
