"""A simulation as a robot's own software logs it: base odometry, key scans, and noise on the odometry's steps.

Apart from ``simulate``, which ends where the sensors end: nothing here looks at the world or the truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from moteslam.errors import ConfigError, InputError
from moteslam.sim.base_odometry import with_odometry
from moteslam.sim.key_scans import key_scans
from moteslam.sim.log_faults import with_gaps, with_odometry_faults
from moteslam.sim.odometry_noise import with_odometry_noise
from moteslam.sim.simulate import EPOCH, Simulation, rng_of


@dataclass(frozen=True)
class Logging:
    """What is logged, besides the base's odometry pose at every scan.

    Attributes:
        every: keep a scan only after this distance [m] (or this ``turn``); None to keep all.
        turn: keep a scan only after this turn [rad] (or this distance); None to keep all.
        noise: shares of noise that are added to each step of the odometry, to its length and to its turn, 0 to 1.

    Raises:
        ConfigError: a distance, turn or share out of bounds.
    """

    every: float | None = None
    turn: float | None = None
    noise: tuple[float, float] | None = None

    def __post_init__(self) -> None:
        for field, value in (("every", self.every), ("turn", self.turn)):
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"{value:g}, expected a finite number above 0", field=field)
        if self.noise is not None and not all(0 <= share <= 1 for share in self.noise):
            raise ConfigError(f"{self.noise[0]:g} {self.noise[1]:g}, expected 0 to 1", field="noise")


def logged(simulation: Simulation, logging: Logging) -> Simulation:
    """The simulation with its recording as it is logged: odometry first, then key scans, then noise on their steps.

    The base goes on through a gap of the log, and what is wrong with its odometry is so after all else.

    Raises:
        InputError: no scans or no encoder readings are left to log.
    """
    faults = simulation.scenario.faults
    base = simulation.recording if simulation.base is None else simulation.base
    recording = with_gaps(with_odometry(base, gyro=base.imu is not None), faults, EPOCH)
    if logging.every is not None or logging.turn is not None:
        distance = math.inf if logging.every is None else logging.every
        recording = key_scans(recording, distance=distance, turn=math.inf if logging.turn is None else logging.turn)
        if recording.lidar is None or len(recording.lidar) < 2:
            raise InputError(
                f"one key scan alone in {simulation.truth.length:.1f} m, expected less distance or turn between two",
                file=recording.name,
            )
    if logging.noise is not None:
        rng = rng_of(simulation.scenario.seed, "odometry")
        distance, rotation = logging.noise
        recording = with_odometry_noise(recording, distance=distance, rotation=rotation, rng=rng)
    recording = with_odometry_faults(recording, faults, EPOCH)
    return replace(simulation, recording=recording.replace(rgbd=simulation.recording.rgbd))
