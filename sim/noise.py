"""How noisy the simulated sensors are: frozen settings, by default those measured on the UCSD robot.

Every figure here names its source; ``docs/scenarios.md`` tables them beside the measurements.
"""

from __future__ import annotations

from typing import Annotated

import numpy as np
from pydantic import Field, model_validator

from moteslam.robot.section import NotNegative, Number, Positive, Section, Share

Factor = Annotated[Number, Field(ge=0.5, le=2)]


class ClockNoise(Section):
    """How a host stamps the readings of a device that itself ticks steadily.

    On the real robot the counts do not follow the intervals between the stamps: the jitter is in the stamping. So a
    stamp is the time of the reading plus a delay; readings that were held up come out in a burst.

    Attributes:
        jitter: scale of the usual, half-normal delay [s].
        late: probability that a reading is held up.
        late_delay: longest such delay [s], uniform from 0.
        burst_interval: shortest interval between two stamps [s].
        rate_error: standard deviation of the device's rate, relative, drawn once a recording.
        offset: that all of its stamps are too late [s]; negative: too early.
        drift: by how much the offset grows [s/s].
        lost: share of its messages that never arrive.
    """

    jitter: NotNegative = 0.0
    late: Share = 0.0
    late_delay: NotNegative = 0.0
    burst_interval: NotNegative = 0.0
    rate_error: NotNegative = 0.0
    offset: Annotated[Number, Field(ge=-10, le=10)] = 0.0
    drift: Annotated[Number, Field(ge=-0.01, le=0.01)] = 0.0
    lost: Annotated[Number, Field(ge=0, lt=1)] = 0.0


class LidarNoise(Section):
    """The Hokuyo UTM-30LX: data sheet, repeated accuracy sigma < 10 mm to 10 m, < 30 mm to 30 m, resolution 1 mm.

    Attributes:
        range_noise: standard deviation of a range at the sensor [m].
        range_noise_per_metre: how it grows with the range [m/m]: 13 mm at 10 m, 23 mm at 30 m.
        dropout: probability that a beam gives no usable reading (``nan``).
        resolution: of a range [m]; 0 for none.
        range_min: below which a beam gives no usable reading [m] (data sheet: 0.1).
        divergence: the angle that a beam is wide, in the scan's plane [rad]; 0 for a line. About 0.013 for this
            sensor (a spot of 0.4 m at 30 m).
        mixed: share of the beams that fall on an edge and tell a range in between.
        pulse: how far apart near and far side of an edge may be to melt into one echo [m]; beyond, one of them is told.
        false_return: share of the beams that meet rain, dust or snow on their way.
        false_scale: how far away such an echo comes from, on average [m] (exponential, the short readings of table 6.1
            of Probabilistic Robotics).
        clock: of the scans.
    """

    range_noise: NotNegative = 0.008
    range_noise_per_metre: NotNegative = 0.0005
    dropout: Share = 0.005
    resolution: NotNegative = 0.001
    range_min: Annotated[Number, Field(ge=0, le=5)] = 0.1
    divergence: Annotated[Number, Field(ge=0, le=0.1)] = 0.0
    mixed: Share = 0.5
    pulse: NotNegative = 1.0
    false_return: Share = 0.0
    false_scale: Positive = 3.0
    clock: ClockNoise = ClockNoise(jitter=0.0003, late=0.002, late_delay=0.005, burst_interval=0.001, rate_error=2e-4)


class EncoderNoise(Section):
    """Wheels that are not what the data sheet says, on a floor that is not even.

    Attributes:
        scale_error: of all the wheels' radius, relative, drawn once a recording.
        radius_error: of each wheel's radius, relative, drawn once a recording.
        track_error: of the effective track, relative, drawn once a recording.
        slip: standard deviation of each side's momentary slip, relative to its travel.
        slip_time: over which the slip stays alike [s].
        radius_factors: what the true radii of the FR, FL, RR, RL wheel are times what they should be.
        missed: share of the ticks that a counter misses.
        bursts: slip bursts a minute, of one side at a time.
        burst_slip: how much more the wheels of that side turn in a burst than they travel, relative.
        burst_time: how long a burst lasts, on average (exponential) [s].
        clock: of the readings (measured: intervals of 25 ms, standard deviation 3.7 to 6.1 ms, 3 to 68 ms).
    """

    scale_error: NotNegative = 0.004
    radius_error: NotNegative = 0.0005
    track_error: NotNegative = 0.01
    slip: NotNegative = 0.02
    slip_time: Positive = 0.5
    radius_factors: tuple[Factor, Factor, Factor, Factor] = (1.0, 1.0, 1.0, 1.0)
    missed: Share = 0.0
    bursts: Annotated[Number, Field(ge=0, le=600)] = 0.0
    burst_slip: Annotated[Number, Field(ge=-1, le=10)] = 0.5
    burst_time: Positive = 0.4
    clock: ClockNoise = ClockNoise(jitter=0.002, late=0.02, late_delay=0.04, burst_interval=0.0032, rate_error=2e-4)


class ImuNoise(Section):
    """The gyro and accelerometer of the UCSD robot, measured while it stood still and while it drove.

    Attributes:
        gyro_noise: standard deviation of an angular velocity at rest [rad/s] (measured 0.0037 to 0.0041).
        gyro_correlation: of that noise with itself one and two readings later (measured 0.91 and 0.69: the device
            filters what it tells); a heading integrates this to about 0.05 degrees a root second.
        gyro_bias: size of the yaw rate's bias [rad/s] (measured 1.0 to 1.3 degrees a minute), either sign.
        gyro_bias_spread: its standard deviation from one recording to another, relative.
        gyro_bias_walk: random walk of the bias [rad/s per root second].
        gyro_scale_error: of the angular velocities, relative, drawn once a recording (usual for such a gyro; without
            a reference it cannot be told from the recordings).
        accelerometer_noise: standard deviation at rest [g] (measured 0.0002 to 0.0013).
        accelerometer_bias: standard deviation of each axis, drawn once a recording [g] (measured 0.004 to 0.016).
        vibration: standard deviation of the horizontal accelerations at 1 m/s [g] (measured 0.024 to 0.028).
        tilting: standard deviation of the roll and pitch rates at 1 m/s [rad/s] (measured 0.03).
        clock: of the readings (measured: 10 ms, standard deviation 1.9 to 2.2 ms, 0.005 to 37 ms).
    """

    gyro_noise: NotNegative = 0.004
    gyro_correlation: tuple[Number, Number] = (0.905, 0.69)
    gyro_bias: NotNegative = float(np.radians(1.15) / 60)
    gyro_bias_spread: NotNegative = 0.1
    gyro_bias_walk: NotNegative = 5e-6
    gyro_scale_error: NotNegative = 0.005
    accelerometer_noise: NotNegative = 0.0007
    accelerometer_bias: NotNegative = 0.01
    vibration: NotNegative = 0.025
    tilting: NotNegative = 0.03
    clock: ClockNoise = ClockNoise(jitter=0.0009, late=0.012, late_delay=0.025, burst_interval=5e-6, rate_error=2e-4)

    @model_validator(mode="after")
    def _is_a_correlation(self) -> ImuNoise:
        one, two = self.gyro_correlation
        if not (-1 < one < 1 and 2 * one**2 - 1 < two < 1):
            raise ValueError(
                f"gyro_correlation of {one:g} and {two:g}, expected two numbers between -1 and 1 that some noise has: "
                "the second above 2 first^2 - 1"
            )
        return self


class Noise(Section):
    """All the sensors' noise.

    Attributes:
        odometry_scale: multiplies the slip, scale, radius and track errors of the encoders and the noise, bias and
            scale error of the gyro.
    """

    odometry_scale: NotNegative = 1.0
    lidar: LidarNoise = LidarNoise()
    encoders: EncoderNoise = EncoderNoise()
    imu: ImuNoise = ImuNoise()

    @classmethod
    def none(cls) -> Noise:
        """Perfect sensors: no noise, no bias, no dropouts, no jitter, ranges as fine as a float32 holds them.

        What is off by default stays off.
        """
        still = ClockNoise()
        return cls(
            odometry_scale=0.0,
            lidar=LidarNoise(range_noise=0.0, range_noise_per_metre=0.0, dropout=0.0, resolution=0.0, clock=still),
            encoders=EncoderNoise(clock=still),
            imu=ImuNoise(accelerometer_noise=0.0, accelerometer_bias=0.0, vibration=0.0, tilting=0.0, clock=still),
        )
