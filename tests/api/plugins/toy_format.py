"""A format of another package: stamps and ranges as comma-separated lines."""

from pathlib import Path

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats import Format, Robot
from moteslam.robot.platform import Platform
from moteslam.robot.recording import LidarStream, Recording

HEAD = "# toy ranges\n"


def recognise(path: Path) -> bool:
    """By its first line."""
    with path.open("rb") as file:
        return file.read(len(HEAD)) == HEAD.encode()


def read(path: Path, sequence: str | int | None, platform: Robot) -> Recording:
    """A lidar and nothing else."""
    try:
        rows = np.loadtxt(path, delimiter=",", ndmin=2)
    except ValueError as error:
        raise InputError(str(error), file=path) from error
    angle = np.pi / (rows.shape[1] - 2)
    lidar = LidarStream(rows[:, 0].copy(), rows[:, 1:].astype(np.float32), -np.pi / 2, angle, 0.1, 30.0)
    return Recording(path.name, platform if isinstance(platform, Platform) else Platform(), lidar=lidar)


FORMAT = Format("toy file (toy ranges)", is_folder=False, recognise=recognise, read=read)
