"""A dense recording as the classic logs were recorded: a scan only where the odometry has moved enough.

Apart from the sensors and from the log formats: it takes any recording with odometry and gives another.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot.recording import EncoderStream, ImuStream, OdometryStream, Recording, nearest_stamp
from moteslam.robot.values import expect_type

Array = NDArray[np.float64]


def key_scans(recording: Recording, *, distance: float = 0.75, turn: float = 0.5) -> Recording:
    """Keep the first scan, then each scan where the odometry has moved or turned enough since the last one kept.

    Both are measured from pose to pose, not summed along the path: the jitter of a standing robot's odometry adds up
    to no scan. All streams that measure motion then have readings at the kept scans:

    - odometry: the pose logged with each, bit for bit.
    - encoders: the counts since the last kept scan, whole numbers of the interpolated counters, so that no remainder
      is lost; those before the first and after the last kept scan are left out.
    - IMU: two readings of a yaw rate between two kept scans, one at either end, so that rate times interval is the
      turn by the odometry (which is the wheels' before the gyro starts and after it ends); an integral over rates
      that are linear between readings then gives the same turn as one over constant rates. The other axes are those
      of the nearest reading.

    Camera frames and the lidar's ``time_increment`` stay. A pose between two kept scans is not recorded any more: what
    integrates counts takes the path between two kept scans for one arc, and its positions, unlike its headings, differ
    from the dense ones (by 0.1 m on 100 m of ``loop``, by metres where no scan was recorded for seconds). Logged poses
    do not: a CARMEN log holds them, a UCSD folder has no place for them.

    Args:
        recording: with an odometry pose at every scan, as `with_odometry` gives it.
        distance: from the last kept scan in a straight line [m]; infinite for turns alone.
        turn: from its heading [rad]; beyond pi for distances alone.

    Raises:
        ConfigError: a distance or turn that is not positive.
        InputError: no scans, or none with odometry poses.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    for field, value, unit in (("distance", distance, "m"), ("turn", turn, "rad")):
        if not value > 0:
            raise ConfigError(f"{value:g} {unit}, expected more than 0", field=field)
    lidar = recording.lidar
    if lidar is None or not len(lidar):
        raise InputError("no lidar scans, expected at least one", file=recording.name, field="lidar")
    if lidar.odometry is None:
        raise InputError("no odometry poses, expected one at every scan", file=recording.name, field="odometry")
    kept = _kept(lidar.odometry, distance, turn)
    stamps, poses = lidar.stamps[kept], lidar.odometry[kept]
    encoders, imu = recording.encoders, recording.imu
    return recording.replace(
        lidar=replace(lidar, stamps=stamps, ranges=lidar.ranges[kept], odometry=poses),
        odometry=OdometryStream(stamps, poses),
        encoders=_summed(encoders, stamps) if encoders is not None and len(encoders) else None,
        imu=_mean_rates(imu, stamps, np.unwrap(lidar.odometry[:, 2])[kept]) if imu is not None and len(imu) else None,
    )


def _kept(odometry: Array, distance: float, turn: float) -> list[int]:
    """The indices of the scans that are kept, by the poses [n, 3] at all of them."""
    kept, (last_x, last_y, last_theta) = [0], odometry[0].tolist()
    for index, (x, y, theta) in enumerate(odometry.tolist()):
        turned = abs(math.remainder(theta - last_theta, 2 * math.pi))
        if math.hypot(x - last_x, y - last_y) >= distance or turned >= turn:
            kept.append(index)
            last_x, last_y, last_theta = x, y, theta
    return kept


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
