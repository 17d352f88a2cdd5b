"""Writing a recording as CSV files, one a stream, and the TOML that describes them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from os import PathLike
from pathlib import Path
from typing import IO, Any

import numpy as np
import tomli_w
from numpy.typing import NDArray

from moteslam.errors import InputError, OutputError
from moteslam.robot.files import write_atomically
from moteslam.robot.formats.csv_model import FOUR_WHEELS
from moteslam.robot.formats.written import not_written
from moteslam.robot.platforms import platform_table
from moteslam.robot.recording import EncoderStream, ImuStream, LidarStream, OdometryStream, Recording, chunks
from moteslam.robot.tables import Table
from moteslam.robot.values import Issue, expect_type

POSE = ("x", "y", "theta")
RATES = ("roll_rate", "pitch_rate", "yaw_rate")
ACCELERATION = ("acceleration_x", "acceleration_y", "acceleration_z")

Rows = Iterator[Sequence[object]]


def write_csv(path: str | PathLike[str], recording: Recording) -> tuple[Issue, ...]:
    """Write a recording as a TOML and, beside it, a CSV file a stream: ``walk.toml``, ``walk-lidar.csv`` and so on.

    Numbers have the fewest digits that read back the same; no return is ``inf``, a reading that says nothing an empty
    cell. So ``read_csv_log`` gives the same streams and robot back, bit for bit, as long as the finite ranges are
    above 0 and lie within ``range_min <= r < range_max``. The same recording gives the same bytes. The TOML is written
    last: it describes complete files.

    Args:
        path: of the TOML; its folder must exist.
        recording: what to write.

    Returns:
        an issue for what CSV files cannot hold: images.

    Raises:
        InputError: no stream with readings.
        OutputError: a name that does not end in ``.toml``; or a file cannot be written.
    """
    expect_type(recording, Recording, "recording", "open_recording(path) reads one")
    path = Path(path)
    if path.suffix != ".toml":
        raise OutputError("expected a name that ends in .toml", file=path)
    makers: dict[str, Callable[[Any], tuple[Table, Rows]]] = {
        "lidar": _lidar,
        "odometry": _odometry,
        "encoders": _encoders,
        "imu": _imu,
    }
    streams = {name: make(stream) for name, make in makers.items() if (stream := getattr(recording, name))}
    if not streams:
        raise InputError("no stream with readings, expected a lidar, odometry, encoders or an IMU", file=recording.name)
    tables: Table = {"name": recording.name}
    for name, (table, rows) in streams.items():
        file = path.with_name(f"{path.stem}-{name}.csv")
        _write(file, rows)
        tables[name] = {"file": file.name, "stamp": "stamp", **table}
    tables["platform"] = platform_table(recording.platform)
    write_atomically(path, tomli_w.dumps(tables))
    return not_written(recording, "a CSV log", ("rgbd",))


def _write(file: Path, rows: Rows) -> None:
    def content(out: IO[bytes]) -> None:
        for row in rows:
            out.write((",".join(map(str, row)) + "\n").encode())

    write_atomically(file, content)


def _lidar(lidar: LidarStream) -> tuple[Table, Rows]:
    beams = lidar.ranges.shape[1]
    names = [f"r{beam}" for beam in range(beams)]
    table: Table = {
        "ranges": f"{names[0]}..{names[-1]}",
        "angle_min": lidar.angle_min,
        "angle_increment": lidar.angle_increment,
        "range_min": lidar.range_min,
        "range_max": lidar.range_max,
    }
    poses = None if lidar.odometry is None else lidar.odometry.tolist()
    if poses is not None:
        table["odometry"] = list(POSE)

    def rows() -> Rows:
        yield ["stamp", *(() if poses is None else POSE), *names]
        scan = 0
        for some in chunks(lidar.ranges):
            cells = some.astype(str)  # the fewest digits that give the same float32
            cells[np.isnan(some)] = ""
            for ranges in cells.tolist():
                yield [repr(float(lidar.stamps[scan])), *(() if poses is None else map(repr, poses[scan])), *ranges]
                scan += 1

    return table, rows()


def _odometry(odometry: OdometryStream) -> tuple[Table, Rows]:
    return {key: key for key in POSE}, _rows(POSE, odometry.stamps, odometry.poses)


def _encoders(encoders: EncoderStream) -> tuple[Table, Rows]:
    table = {**{key: key for key in FOUR_WHEELS}, "running": False}
    return table, _rows(FOUR_WHEELS, encoders.stamps, encoders.counts)


def _imu(imu: ImuStream) -> tuple[Table, Rows]:
    values = np.concatenate((imu.angular_velocity, imu.linear_acceleration_g), axis=1)
    table = {**{key: key for key in RATES}, "acceleration": list(ACCELERATION)}
    return table, _rows((*RATES, *ACCELERATION), imu.stamps, values)


def _rows(names: Sequence[str], stamps: NDArray[np.float64], values: NDArray[Any]) -> Rows:
    """The header and, a line a reading, its stamp [n] and its values [n, k]."""
    yield ["stamp", *names]
    for stamp, row in zip(stamps.tolist(), values.tolist(), strict=True):
        yield [repr(stamp), *map(repr, row)]
