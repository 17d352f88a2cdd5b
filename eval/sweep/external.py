"""Anyone's SLAM as a configuration: a command that is given a recording, and writes a trajectory and perhaps a map."""

from __future__ import annotations

import tempfile
import warnings
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from moteslam.errors import InputError, MoteslamError, MoteslamWarning
from moteslam.eval.sweep.program import run_program
from moteslam.robot.formats.carmen_writer import write_carmen
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.formats.ucsd import write_ucsd
from moteslam.robot.platforms import write_platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.logged import with_odometry

RecordingFormat = Literal["carmen", "ucsd"]
SEQUENCE = 0
"""Number in the file names of the format ``ucsd``."""


@dataclass(frozen=True)
class Command:
    """An external SLAM.

    Attributes:
        words: the program and its arguments; in each ``{recording}`` stands for the file or folder of the recording,
            ``{platform}`` for its robot as TOML, ``{out}`` for an empty folder, ``{seed}`` for the seed.
        format: in which it is given the recording: ``carmen``, a log, or ``ucsd``, a folder of arrays.
        trajectory: file in ``{out}`` with its trajectory, on the clock of the recording: TUM, or another format of
            `read_trajectory`.
        map: map_server ``.yaml`` file in ``{out}``, in the frame of the trajectory; empty if it has none.
        version: what is recorded of the program; it changes nothing.
    """

    words: tuple[str, ...]
    format: RecordingFormat
    trajectory: str
    map: str
    version: str = ""


def estimate(command: Command, recording: Recording, seed: int) -> tuple[Trajectory, Raster | None]:
    """Run an external SLAM over a recording; its trajectory, and its map if it wrote one.

    Nothing but the recording and its robot is given to it; what it prints is thrown away, but for the last line of one
    that fails. Who calls sets the time limit.

    Raises:
        InputError: the recording cannot be written in that format; the command is not there, fails, or writes no
            trajectory, or one that cannot be read.
    """
    with tempfile.TemporaryDirectory(prefix="moteslam-") as temporary:
        folder = Path(temporary)
        out, given = folder / "out", folder / "in"
        out.mkdir()
        given.mkdir()
        try:
            if command.format == "carmen":
                file = given / "recording.log"
                write_carmen(file, _with_poses(recording))
            else:
                file = given
                write_ucsd(given, recording, sequence=SEQUENCE)
        except MoteslamError as error:
            problem = f"the recording cannot be given to it in the format {command.format}: {error.problem}"
            raise InputError(problem, file=command.words[0]) from error
        robot = given / "platform.toml"
        write_platform(robot, recording.platform)
        names = {"recording": file, "platform": robot, "out": out, "seed": seed}
        words = [_filled(word, names) for word in command.words]
        run_program(words, out)
        if not (out / command.trajectory).is_file():
            raise InputError(f"wrote no {command.trajectory}, expected its trajectory in {{out}}", file=words[0])
        try:
            trajectory = read_trajectory(out / command.trajectory)
            for issue in trajectory.warnings:
                warnings.warn(MoteslamWarning(str(issue)), stacklevel=2)
            occupancy = read_map(out / command.map) if command.map and (out / command.map).exists() else None
        except MoteslamError as error:  # its file is gone soon
            where = f"{Path(error.file).name}: " if error.file is not None else ""
            raise InputError(f"{where}{error.problem}", file=words[0], field=error.field) from error
        return trajectory, occupancy


def _filled(word: str, names: dict[str, object]) -> str:
    for name, value in names.items():
        word = word.replace(f"{{{name}}}", str(value))
    return word


def _with_poses(recording: Recording) -> Recording:
    """With the odometry poses that a log has, as the base integrates them."""
    if recording.odometry is not None or (recording.lidar is not None and recording.lidar.odometry is not None):
        return recording
    return with_odometry(recording, gyro=recording.imu is not None)
