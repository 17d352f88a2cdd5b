"""A trajectory in another format, for ``moteslam convert``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from moteslam.errors import ConfigError, OutputError
from moteslam.eval.cli.text import say, say_json, warn
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.robot.trajectory import Trajectory
    from moteslam.robot.values import Issue


def stands_for_trajectory(out: Path, to: str | None) -> bool:
    """Whether the format that is named, or that the ending of OUT stands for, is one of trajectories."""
    from moteslam.robot.trajectories import trajectory_format_to_write

    try:
        trajectory_format_to_write(out, to)
    except (ConfigError, OutputError):
        return False
    return True


def convert_trajectory(path: Path, out: Path, to: str | None, *, force: bool, as_json: bool) -> None:
    """Write a trajectory in the format of a name, or of the ending of OUT; the edges of a pose graph are left out.

    Args:
        path: a trajectory.
        out: of the file; KITTI's stamps lie beside it.
        to: the name of a format, if any.
        force: replace what is there.
        as_json: print the result as JSON.

    Raises:
        ConfigError: no such format.
        InputError: the trajectory is broken, or has stamps that the format cannot hold.
        OutputError: the file exists, or cannot be written.
    """
    from moteslam.robot.files import staged_file
    from moteslam.robot.trajectories import trajectory_format_to_write
    from moteslam.robot.values import counted

    try:
        name, known = trajectory_format_to_write(out, to)
    except (ConfigError, OutputError) as error:
        raise ConfigError(f"{path} is a trajectory: {error.problem}", field="--to") from error
    with staged_file(out, force=force, keep=path) as file:
        trajectory, issues = _read(path)
        known.write(file, trajectory)
    if as_json:
        warnings = [issue.as_dict() for issue in issues]
        say_json({"out": str(out), "format": name, "poses": len(trajectory), "warnings": warnings})
        return
    warn(issues)
    say(f"{literal(path.name)}: {counted(len(trajectory), 'pose')}, {trajectory.length:.1f} m")
    say(f"wrote {literal(out)}, {name}")


def _read(path: Path) -> tuple[Trajectory, tuple[Issue, ...]]:
    """A trajectory, and what of its file is no part of it.

    Raises:
        InputError: it is broken.
    """
    import numpy as np

    from moteslam.robot.trajectories import TRAJECTORY_FORMATS, read_trajectory, trajectory_format_of
    from moteslam.robot.trajectories.bag import is_bag, parts_of
    from moteslam.robot.trajectories.g2o import read_both
    from moteslam.robot.values import Issue, counted

    if parts_of(path) is not None or is_bag(path) or trajectory_format_of(path) is not TRAJECTORY_FORMATS["g2o"]:
        trajectory, edges = read_trajectory(path), 0
    else:
        graph, trajectory = read_both(path)
        edges = len(graph.first)
    issues = trajectory.warnings
    if trajectory.space is not None:
        span = float(np.ptp(trajectory.space.positions[:, 2]))
        text = f"{path.name}: z, which spans {span:.2f} m, roll and pitch not written: poses are those in x and y"
        issues += (Issue("not-written", text, len(trajectory)),)
    if edges:
        text = f"{path.name}: {counted(edges, 'edge')} not written, no part of a trajectory"
        issues += (Issue("not-written", text, edges),)
    return trajectory, issues
