"""A recording mended by what its calibration says is certain."""

from dataclasses import replace
from typing import Literal

import numpy as np

from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.se2 import Array
from moteslam.robot.values import expect_type
from moteslam.slam.calibration.calibrate import Calibration
from moteslam.slam.calibration.findings import changed_ranges, figures_of, lidar_of, mount_of, stamped_at_end
from moteslam.slam.calibration.hand_eye import CLOCKS, Fit, Parameter
from moteslam.slam.calibration.readings import in_form, with_stamps
from moteslam.slam.inputs.odometry_path import OdometryPath
from moteslam.slam.inputs.synchronise import require_lidar

Side = Literal["lidar", "odometry"]

NOT_MENDED = {
    *("odometry-unfit", "odometry-turn-scale", "scans-unfit", "lidar-tilted", "range-change", "range-max"),
    *("mount-moves", "no-gyro", "gyro-bias", "other-clock"),
}
"""What is told and not mended; what is left out says so."""


def calibrated(recording: Recording, calibration: Calibration, side: Side | None) -> Recording:
    """A recording mended by what is certain of its calibration.

    Args:
        side: what is taken to be wrong where the two contradict each other and scans cannot say which is: one that is
            a mirror image, the ratio of lengths, the clock; None mends only what is known to be on one side
            (``Findings.decided``): the odometry's clock and poses, a mirror image if a third witness says which.
    """
    expect_type(calibration, Calibration, "calibration", "calibrate(recording) gives one, if the robot turns enough")
    c, lidar = calibration, recording.lidar
    if lidar is not None and not c.correlation:
        return recording.replace(encoders=None, imu=None, odometry=None, lidar=replace(lidar, odometry=None))
    recording = recording if c.step is None else c.step.undone(recording)
    recording = recording if c.gyro else recording.replace(imu=None)
    mirror = (c.wrong or side) if c.mirrored and c.fits else None
    c = replace(c, mirrored=mirror == "lidar")
    if mirror in ("odometry", "gyro"):  # the mount was found in the mirror
        signs = [-1 if k in (Parameter.Y, Parameter.YAW) else 1 for k in Parameter]
        c = replace(c, fit=c.fit._replace(values=c.fit.values * signs))
    certain = {figure.name.split(" ")[0] for figure in figures_of(c, recording) if figure.certain}
    if side is None:
        certain &= {"offset", "drift"}
    scale = float(c.fit.values[Parameter.LENGTHS]) if "lengths" in certain else 1.0
    x, y, yaw = mount_of(c, recording, certain, scale if side == "lidar" else 1.0)
    offset, drift = c.fit.values[CLOCKS] if not c.shared_clock else (0.0, 0.0)
    mended = recording.replace(
        platform=recording.platform.model_copy(
            update={"lidar": recording.platform.lidar.model_copy(update={"x": x, "y": y, "yaw": yaw})}
        )
    )
    if c.fits and (c.form, c.heading_offset) != ("stated", 0.0):
        mended = mended.with_poses(lambda *path: in_form(OdometryPath(*path), c.form, c.heading_offset).poses)
    lidar = lidar_of(require_lidar(mended), c, certain)
    if c.sweep is not None and c.sweep >= 0 and side is not None:
        lidar = replace(lidar, time_increment=c.sweep / (lidar.ranges.shape[1] - 1))
    mended = mended.replace(lidar=lidar)
    if mirror in ("odometry", "gyro"):
        mended = _mirror_image(mended, gyro=mirror == "gyro" or not c.wrong, poses=mirror == "odometry")
    if c.late:
        stream = "imu" if c.late == "gyro" else c.late
        mended, offset, drift = with_stamps(mended, (stream,), lambda stamps: stamps - offset), 0.0, 0.0
    lidar = require_lidar(mended)
    if lidar.odometry is not None and (offset or drift):
        at = lidar.stamps + offset + drift * (lidar.stamps - c.fit.middle)
        mended = mended.replace(lidar=replace(lidar, odometry=se2.interpolate(lidar.stamps, lidar.odometry, at)))
        offset = drift = 0.0
    if side == "lidar" or (side is None and stamped_at_end(calibration, recording)):
        # with the scans on the odometry's clock, and their ranges as long as it
        lidar, factor = require_lidar(mended), np.float32(1 / scale)
        stamps = lidar.stamps + offset + drift * (lidar.stamps - c.fit.middle)
        ranges = lidar.ranges if scale == 1 else changed_ranges(lidar, lambda ranges: ranges * factor)
        limit = lidar.range_max / scale
        return mended.replace(lidar=replace(lidar, stamps=stamps, ranges=ranges, range_max=limit))
    return _other_odometry(mended, c.fit, scale, offset, drift)


def _mirror_image(recording: Recording, *, gyro: bool, poses: bool) -> Recording:
    """With the gyro's turns negated, and with poses and wheels mirrored."""
    encoders, imu = recording.encoders, recording.imu
    if gyro and imu is not None:
        recording = recording.replace(imu=replace(imu, angular_velocity=imu.angular_velocity * (1, 1, -1)))
    if not poses:
        return recording
    if encoders is not None:
        recording = recording.replace(encoders=replace(encoders, counts=encoders.counts[:, [1, 0, 3, 2]]))
    return recording.with_poses(lambda _, poses: poses * (1, -1, -1))


def _other_odometry(recording: Recording, fit: Fit, scale: float, offset: float, drift: float) -> Recording:
    """With the odometry on the lidar's clock, and as long as its ranges."""
    wheels = recording.platform.wheels
    recording = recording.with_poses(lambda _, poses: poses * (scale, scale, 1.0))
    if scale != 1 and recording.encoders is not None and wheels is not None:
        changed = fit.wheels(wheels, gyro=recording.imu is not None)
        platform = recording.platform.model_copy(update={"wheels": wheels.model_copy(update=changed)})
        recording = recording.replace(platform=platform)

    def on_the_lidars_clock(stamps: Array) -> Array:
        return fit.middle + (stamps - offset - fit.middle) / (1 + drift)

    return with_stamps(recording, ("odometry", "encoders", "imu"), on_the_lidars_clock)
