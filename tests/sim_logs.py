"""A recorded drive too simple to need a simulation, for tests of what is made of recordings."""

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.platforms import UCSD
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, Recording

START = 1_300_000_000.0


def winding(seed: int = 0, seconds: float = 60.0) -> Recording:
    """A drive of two turns that winds, with jittered stamps; its IMU starts late and ends early."""
    rng = np.random.default_rng(seed)
    stamps = jittered(0.0, seconds, 40, rng)
    swing = 2 * np.sin(stamps / 3)
    sides = np.stack((16 + swing, 14 - swing, 16 + swing, 14 - swing), axis=1)
    counts = np.rint(sides + rng.normal(0, 1, sides.shape)).astype(np.int64)
    at = jittered(0.4, seconds - 1.5, 100, rng)
    angular = rng.normal(0, 0.004, (len(at), 3))
    angular[:, 2] += 0.24 + 0.47 * np.sin(at / 3)
    scans = jittered(0.1, seconds - 0.3, 40, rng)
    return Recording(
        "winding",
        UCSD,
        lidar=LidarStream(
            START + scans, rng.uniform(1, 9, (len(scans), 181)).astype(np.float32), -np.pi / 2, np.pi / 180, 0.1, 30.0
        ),
        encoders=EncoderStream(START + stamps, counts),
        imu=ImuStream(START + at, angular, np.tile((0.0, 0.0, 1.0), (len(at), 1))),
    )


def jittered(start: float, end: float, rate: float, rng: np.random.Generator) -> NDArray[np.float64]:
    """Stamps that stray by a third of an interval."""
    stamps = np.arange(start, end, 1 / rate)
    return stamps + rng.uniform(-0.3, 0.3, len(stamps)) / rate
