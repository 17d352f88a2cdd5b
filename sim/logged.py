"""A simulation as a robot's own software logs it: base odometry, key scans, and noise on the odometry's steps.

Nothing here looks at the world or the truth: each function makes one recording of another.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.platform import Wheels
from moteslam.robot.recording import EncoderStream, ImuStream, OdometryStream, Recording, nearest_stamp
from moteslam.robot.se2 import Array
from moteslam.robot.wheel_odometry import gyro_covers, wheel_motion, wheel_path
from moteslam.sim.sensors.faults import with_gaps, with_odometry_faults
from moteslam.sim.simulate import Simulation, random_generators


@dataclass(frozen=True)
class Logging:
    """What is logged, besides the base's odometry pose at every scan."""

    every: float | None = None  # keep a scan only after this distance [m]
    turn: float | None = None  # or turn [rad]; all where both are None
    noise: tuple[float, float] | None = None  # added to each step of the odometry, as shares of its length and turn

    def __post_init__(self) -> None:
        for field, value in (("every", self.every), ("turn", self.turn)):
            if value is not None and not 0 < value < math.inf:
                raise ConfigError(f"{value:g}, expected a finite number above 0", field=field)
        if self.noise is not None and not all(0 <= share <= 1 for share in self.noise):
            raise ConfigError(f"{self.noise[0]:g} {self.noise[1]:g}, expected 0 to 1", field="noise")


def logged(simulation: Simulation, logging: Logging) -> Simulation:
    """The simulation with its recording as it is logged: odometry first, then key scans, then noise on their steps.

    The base goes on through a gap of the log, and what is wrong with its odometry is so after all else.
    """
    faults = simulation.scenario.faults
    base = simulation.base
    recording = with_gaps(with_odometry(base, gyro=base.imu is not None), faults)
    if logging.every is not None or logging.turn is not None:
        recording = key_scans(recording, distance=logging.every or math.inf, turn=logging.turn or math.inf)
        if recording.lidar is None or len(recording.lidar) < 2:
            raise InputError(
                f"one key scan alone in {simulation.truth.length:.1f} m, expected less distance or turn between two",
                file=recording.name,
            )
    if logging.noise is not None:
        rng = random_generators(simulation.scenario.seed)["odometry"]
        distance, rotation = logging.noise
        recording = with_odometry_noise(recording, distance=distance, rotation=rotation, rng=rng)
    recording = with_odometry_faults(recording, faults)
    return replace(simulation, recording=recording.replace(rgbd=simulation.recording.rgbd))


def with_odometry(recording: Recording, *, gyro: bool = False) -> Recording:
    """The recording with dead reckoning from its encoders, by exact arcs, and its pose at every scan.

    With ``gyro`` the turns are the gyro's while it measures. Without, the IMU is left out: integrating the streams, as
    SLAM does after a UCSD folder is read, gives the poses that are logged here.
    """
    if gyro and (recording.imu is None or len(recording.imu) < 2):
        raise InputError("no gyro, expected at least two readings", file=recording.name, field="imu")
    poses = wheel_path(recording, gyro=gyro)
    assert recording.encoders is not None  # else there is no path
    odometry, lidar = OdometryStream(recording.encoders.stamps, poses), recording.lidar
    if lidar is not None:
        lidar = replace(lidar, odometry=se2.interpolate(odometry.stamps, odometry.poses, lidar.stamps))
    return recording.replace(odometry=odometry, lidar=lidar, imu=recording.imu if gyro else None)


def key_scans(recording: Recording, *, distance: float = 0.75, turn: float = 0.5) -> Recording:
    """Keep the first scan, then each where the odometry is ``distance`` [m] or ``turn`` [rad] from the last one kept.

    Measured from pose to pose: the jitter of a standing robot adds up to no scan. The other streams have readings at
    the kept scans:

    - odometry: the pose logged with each, bit for bit.
    - encoders: whole counts since the last kept scan, so that no remainder is lost.
    - IMU: a yaw rate at either end between two kept scans, so that rate times interval is the turn by the odometry;
      the other axes are those of the nearest reading.

    Counts between two kept scans make one arc, so positions by them, unlike headings, differ from the dense ones (0.1 m
    on 100 m of ``loop``); the logged poses do not.
    """
    lidar = recording.lidar
    if lidar is None or not len(lidar):
        raise InputError("no lidar scans, expected at least one", file=recording.name, field="lidar")
    assert lidar.odometry is not None
    kept = _kept(lidar.odometry, distance, turn)
    stamps, poses = lidar.stamps[kept], lidar.odometry[kept]
    encoders, imu = recording.encoders, recording.imu
    return recording.replace(
        lidar=lidar.take(kept),
        odometry=OdometryStream(stamps, poses),
        encoders=_summed(encoders, stamps) if encoders is not None and len(encoders) else None,
        imu=_mean_rates(imu, stamps, np.unwrap(lidar.odometry[:, 2])[kept]) if imu is not None and len(imu) else None,
    )


def _kept(odometry: Array, distance: float, turn: float) -> NDArray[np.intp]:
    """The indices of the scans that are kept, by the poses [n, 3] at all of them."""
    kept, (last_x, last_y, last_theta) = [0], odometry[0].tolist()
    for index, (x, y, theta) in enumerate(odometry.tolist()):
        turned = abs(math.remainder(theta - last_theta, 2 * math.pi))
        if math.hypot(x - last_x, y - last_y) >= distance or turned >= turn:
            kept.append(index)
            last_x, last_y, last_theta = x, y, theta
    return np.array(kept)


def _summed(encoders: EncoderStream, stamps: Array) -> EncoderStream:
    """The counts between consecutive stamps [n]; the first has none before it."""
    counters = np.cumsum(encoders.counts, axis=0).T
    read = np.rint([np.interp(stamps, encoders.stamps, counter) for counter in counters]).T.astype(np.int64)
    return EncoderStream(stamps, np.diff(read, axis=0, prepend=read[:1]))


def _mean_rates(imu: ImuStream, stamps: Array, headings: Array) -> ImuStream:
    """Two readings an interval between stamps [n] [s], at its ends, of the rate that turns from heading to heading."""
    elapsed = np.diff(stamps)
    rates = np.divide(np.diff(headings), elapsed, out=np.zeros_like(elapsed), where=elapsed > 0)
    ends = np.repeat(stamps, 2)[1:-1]
    nearest = nearest_stamp(imu.stamps, ends)
    angular_velocity = imu.angular_velocity[nearest]
    angular_velocity[:, 2] = np.repeat(rates, 2)
    return ImuStream(ends, angular_velocity, imu.linear_acceleration_g[nearest])


def with_odometry_noise(
    recording: Recording, *, distance: float, rotation: float, rng: np.random.Generator
) -> Recording:
    """Independent Gaussian noise on every step between two odometry readings, in poses and counts alike.

    A step of length d and turn a becomes the arc of d (1 + distance e1) and a (1 + rotation e2), with e1 and e2 of
    N(0, 1): a straight step stays straight. A turn that the gyro measured stays as it is. Over n equal steps the error
    of the length is ``distance`` / sqrt(n) of it: at 40 readings a second 0.1 is mild, at key scans it is what classic
    logs have. What is rounded off the counts of a reading goes to the next. Encoders have the odometry's stamps.
    """
    odometry, encoders, lidar = recording.odometry, recording.encoders, recording.lidar
    assert odometry is not None
    if distance == rotation == 0:
        return recording
    factors = 1 + rng.standard_normal((len(odometry) - 1, 2)) * (distance, rotation)
    if encoders is not None and (wheels := recording.platform.wheels) is not None:
        encoders = EncoderStream(encoders.stamps, _with_whole_counts(encoders.counts, factors, wheels))
    by_gyro = gyro_covers(odometry.stamps, np.empty(0) if recording.imu is None else recording.imu.stamps)[1:]
    steps = se2.between(odometry.poses[:-1], odometry.poses[1:])
    noisy = _scaled(steps, factors[:, 0], np.where(by_gyro, 1.0, factors[:, 1]))
    poses = np.concatenate((odometry.poses[:1], se2.accumulate(noisy, odometry.poses[0])))
    if lidar is not None:
        lidar = replace(lidar, odometry=se2.interpolate(odometry.stamps, poses, lidar.stamps))
    return recording.replace(odometry=OdometryStream(odometry.stamps, poses), encoders=encoders, lidar=lidar)


def _scaled(steps: Array, length: Array, turn: Array) -> Array:
    """Steps [n, 3] whose length and turn are multiplied by [n] each: of an arc comes the longer, more bent arc."""
    turns = steps[:, 2] * turn
    bend = (turns - steps[:, 2]) / 2
    chord = length * np.sinc(turns / (2 * np.pi)) / np.sinc(steps[:, 2] / (2 * np.pi))
    cos, sin = chord * np.cos(bend), chord * np.sin(bend)
    return np.stack((cos * steps[:, 0] - sin * steps[:, 1], sin * steps[:, 0] + cos * steps[:, 1], turns), axis=1)


def _with_whole_counts(counts: NDArray[np.int64], factors: Array, wheels: Wheels) -> NDArray[np.int64]:
    """Counts [n, 4] with the noise of all steps [n - 1, 2], of distance and turn; the first reading is of no step."""
    distance, turn = wheel_motion(counts[1:], wheels)
    longer, turned = distance * (factors[:, 0] - 1), turn * (factors[:, 1] - 1) * wheels.effective_track / 2
    right, left = longer + turned, longer - turned
    added = np.cumsum(np.stack((right, left, right, left), axis=1), axis=0) / wheels.metres_per_count
    whole = np.rint(added).astype(np.int64)
    return counts + np.diff(whole, axis=0, prepend=np.zeros((2, 4), np.int64))
