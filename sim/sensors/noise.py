"""The noise of all sensors: ``[noise]`` in a scenario, by default as measured on the UCSD robot.

Every figure names its source beside its sensor; ``docs/reference/scenarios.md`` tables them beside the measurements.
"""

from __future__ import annotations

from moteslam.robot.section import NotNegative, Section
from moteslam.sim.sensors.clock import ClockNoise
from moteslam.sim.sensors.encoders import EncoderNoise
from moteslam.sim.sensors.imu import ImuNoise
from moteslam.sim.sensors.lidar import LidarNoise


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
