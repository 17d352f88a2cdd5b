"""Anyone's SLAM as a configuration: a command that is given a recording, and writes a trajectory and perhaps a map."""

from __future__ import annotations

import subprocess
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from moteslam.errors import InputError, MoteslamError
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.formats.ucsd import write_ucsd
from moteslam.robot.formats.written import write_carmen
from moteslam.robot.platforms import write_platform
from moteslam.robot.raster import Raster
from moteslam.robot.recording import Recording
from moteslam.robot.trajectories import read_trajectory
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.logged import with_odometry

RecordingFormat = Literal["carmen", "ucsd"]
TAIL, LONGEST_VERSION = 300, 200
"""Characters of the last line that a program printed that go into the error, and of a version."""


@dataclass(frozen=True)
class Command:
    """An external SLAM: a program and its arguments, the format of its recording, and what it writes into ``{out}``.

    In each word ``{recording}`` stands for the file or folder of the recording, ``{platform}`` for its robot as TOML,
    ``{out}`` for an empty folder, ``{seed}`` for the seed. The trajectory is on the clock of the recording, the map,
    which may be missing, in the trajectory's frame. The version changes nothing.
    """

    words: tuple[str, ...]
    format: RecordingFormat
    trajectory: str
    map: str
    version: str = ""


def estimate(command: Command, recording: Recording, seed: int) -> tuple[Trajectory, Raster | None]:
    """Run an external SLAM over a recording; its trajectory, and its map if it wrote one.

    Nothing but the recording and its robot is given to it; of what it prints the last line of one that fails is kept.
    """
    with tempfile.TemporaryDirectory(prefix="moteslam-") as temporary:
        out, given = Path(temporary) / "out", Path(temporary) / "in"
        out.mkdir()
        given.mkdir()
        try:
            file = given
            if command.format == "ucsd":
                write_ucsd(given, recording, sequence=0)
            else:  # a log has odometry poses, as the base integrates them
                file = given / "recording.log"
                posed = recording.odometry is not None or getattr(recording.lidar, "odometry", None) is not None
                write_carmen(file, recording if posed else with_odometry(recording, gyro=recording.imu is not None))
        except MoteslamError as error:
            problem = f"the recording cannot be given to it in the format {command.format}: {error.problem}"
            raise InputError(problem, file=command.words[0]) from error
        robot = given / "platform.toml"
        write_platform(robot, recording.platform)
        words = list(command.words)
        for name, value in {"recording": file, "platform": robot, "out": out, "seed": seed}.items():
            words = [word.replace(f"{{{name}}}", str(value)) for word in words]
        run_program(words, out)
        if not (out / command.trajectory).is_file():
            raise InputError(f"wrote no {command.trajectory}, expected its trajectory in {{out}}", file=words[0])
        try:
            trajectory = read_trajectory(out / command.trajectory)
            occupancy = read_map(out / command.map) if command.map and (out / command.map).exists() else None
        except MoteslamError as error:  # its file is gone soon
            where = f"{Path(error.file).name}: " if error.file is not None else ""
            raise InputError(f"{where}{error.problem}", file=words[0], field=error.field) from error
        return trajectory, occupancy


def run_program(words: Sequence[str], folder: Path | None = None) -> str:
    """Run a program to its end, without input, in a folder; what it wrote to stdout."""
    try:
        done = subprocess.run(words, cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, check=False)
    except OSError as error:
        raise InputError(f"cannot be run: {error.strerror or error}", file=words[0]) from error
    if done.returncode:
        printed = (done.stderr or done.stdout).decode("utf-8", errors="replace").strip().splitlines()
        last = f": {printed[-1][-TAIL:]}" if printed else ""
        raise InputError(f"ended with exit code {done.returncode}{last}", file=words[0])
    return done.stdout.decode("utf-8", errors="replace")


def version_of(words: Sequence[str]) -> str:
    """The first line that a program prints."""
    line = next((line.strip() for line in run_program(words).splitlines() if line.strip()), "")
    if not line:
        raise InputError("printed nothing, expected a version", file=words[0])
    return line[:LONGEST_VERSION]
