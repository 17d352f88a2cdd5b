"""What ``moteslam inspect`` measures of the sensors, beside what the recording's platform has."""

from __future__ import annotations

from math import degrees
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from moteslam.robot.inspection import Inspection
    from moteslam.robot.platform import EncoderSpec, ImuSpec, Platform
    from moteslam.robot.sensor_reports import LidarReport
    from moteslam.slam.calibration.findings import Figure

Row = tuple[str, str, str]
"""A figure's name, as measured, and by the platform."""

NONE = "-"


def figures(found: Inspection, platform: Platform) -> list[Row]:
    """The rows of the table of sensors; a ``-`` stands for what cannot be measured or what the platform has not.

    Args:
        found: what was measured.
        platform: of the recording.
    """
    rates = {stream.name: stream.mean_rate for stream in found.streams}
    rows: list[Row] = []
    if found.lidar is not None:
        rows += _lidar(found.lidar, rates.get("lidar"), platform)
    if found.wheels is not None:
        rows.append(("encoder rate", or_dash(rates.get("encoders"), "{:.1f} Hz"), _rate_of(platform.encoders)))
        rows.append(("encoder counts FR FL RR RL", " ".join(map(str, found.wheels.counts)), NONE))
    if "imu" in rates:
        rows.append(("IMU rate", or_dash(rates["imu"], "{:.1f} Hz"), _rate_of(platform.imu)))
    if (gyro := found.gyro_at_rest) is not None:
        noise = platform.noise.imu
        known = platform.imu is not None
        rows.append(("gyro at rest, mean", f"{gyro.mean:.5f} rad/s", f"{noise.gyro_bias:.5f} rad/s" if known else NONE))
        rows.append(
            ("gyro at rest, noise", f"{gyro.deviation:.5f} rad/s", f"{noise.gyro_noise:.5f} rad/s" if known else NONE)
        )
    return rows


def calibration_row(figure: Figure) -> tuple[str, str, str, str]:
    """An estimate beside what is stated."""
    from moteslam.slam.calibration.findings import WITHIN

    reach = WITHIN * figure.deviation
    return figure.name, f"{figure.value:.4f}", f"+-{reach:.4f}", f"{figure.stated:g}"


def or_dash(value: float | None, form: str) -> str:
    """A value in words, a dash for None."""
    return NONE if value is None else form.format(value)


def _lidar(found: LidarReport, rate: float | None, platform: Platform) -> list[Row]:
    spec, noise, at_rest = platform.lidar, platform.noise.lidar, found.noise_at_rest
    simulated = spec.rate is not None  # a platform that gives no rate gives no noise either
    rows = [
        ("lidar beams", _beams(found), or_dash(spec.beams, "{}")),
        ("first beam", _angle(found.angle_min), _angle(spec.angle_min)),
        ("between beams", _angle(found.angle_increment), _angle(spec.angle_increment)),
        ("turns", found.turns, _turns(spec.angle_increment)),
        ("scan rate", or_dash(rate, "{:.2f} Hz"), or_dash(spec.rate, "{:g} Hz")),
        ("shortest limit", f"{found.range_min:g} m", or_dash(spec.range_min, "{:g} m")),
        ("longest limit", f"{found.range_max:g} m", or_dash(spec.range_max, "{:g} m")),
        ("nearest endpoint", or_dash(found.nearest, "{:.3f} m"), NONE),
        ("farthest endpoint", or_dash(found.farthest, "{:.3f} m"), NONE),
        ("range resolution", _millimetres(found.resolution), _millimetres(noise.resolution if simulated else None)),
    ]
    if at_rest is not None:
        expected = noise.range_noise + noise.range_noise_per_metre * at_rest.at_range
        rows.append(
            (
                f"range noise at {at_rest.at_range:.2f} m, at rest",
                _millimetres(at_rest.deviation),
                _millimetres(expected if simulated else None),
            )
        )
    else:
        rows.append(("range noise at rest", NONE, NONE))
    rows.append(("dropouts", _percent(found.invalid), _percent(noise.dropout if simulated else None)))
    rows.append(("no return", _percent(found.no_return), NONE))
    return rows


def _beams(found: LidarReport) -> str:
    beams = -(-found.beams // found.interlace)
    return f"{beams} of {found.beams}" if found.interlace > 1 else str(beams)


def _percent(share: float | None) -> str:
    return NONE if share is None else f"{100 * share:.2f} %"


def _turns(increment: float | None) -> str:
    return NONE if increment is None else "clockwise" if increment < 0 else "counterclockwise"


def _angle(value: float | None) -> str:
    return NONE if value is None else f"{degrees(value):.4g} deg"


def _rate_of(sensor: EncoderSpec | ImuSpec | None) -> str:
    return NONE if sensor is None else f"{sensor.rate:g} Hz"


def _millimetres(value: float | None) -> str:
    return NONE if value is None else f"{1000 * value:.3g} mm"
