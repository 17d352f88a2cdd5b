"""SLAM programs of others as commands, as a sweep has them, over the drive that ours runs over."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from os import PathLike
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError
from moteslam.eval.bench.document import PeerResult
from moteslam.eval.bench.figures import spread
from moteslam.eval.bench.loops import without_folders
from moteslam.eval.bench.tasks.runs import DURATION, SCENARIO, SEED
from moteslam.eval.sweep.plan import PlannedRun
from moteslam.eval.sweep.spec import Configuration, read_spec
from moteslam.eval.sweep.workers import make_all

OUR_OPTIONS = ("--threads", "1", "--no-figures", "--set", "backend.method=none")


@dataclass(frozen=True)
class Peer:
    """A SLAM program.

    Attributes:
        name: of its configuration.
        command: as `PlannedRun` has it: words, format, trajectory, map, version.
        timeout: it has failed if it takes longer [s].
    """

    name: str
    command: tuple[Any, ...]
    timeout: float = field(default=600.0)


def ours(particles: int) -> Peer:
    """Moteslam as such a command: the process from start to end, reading the same file."""
    words = (sys.executable, "-m", "moteslam", "replay", "{recording}", "--out", "{out}/result", "--platform")
    options = ("{platform}", "--particles", str(particles), *OUR_OPTIONS)
    name = f"moteslam, {particles} particle{'s' if particles > 1 else ''}"
    return Peer(name, ((*words, *options), "carmen", "result/trajectory_final.tum", ""))


def read_peers(path: str | PathLike[str]) -> list[Peer]:
    """The commands among the configurations of a sweep's specification, after ours.

    Its time limit holds; scenarios, seeds and what varies are the bench's own.

    Raises:
        ConfigError: it is no specification, has no command, or a command asks for another scenario or robot.
    """
    path = Path(path)
    spec = read_spec(path)
    commands = {name: one for name, one in spec.configurations.items() if one.command}
    if not commands:
        problem = "no configuration with a command, expected one or more"
        raise ConfigError(problem, file=path, field="configurations")
    for name, one in commands.items():
        if one.set:
            problem = f"{next(iter(one.set))}, expected none: all run over the same recording"
            raise ConfigError(problem, file=path, field=f"configurations.{name}.set")
    given = [Peer(name, _command(one), spec.timeout) for name, one in commands.items()]
    return [ours(1), ours(30), *given]


def _command(one: Configuration) -> tuple[Any, ...]:
    return one.command, one.format, one.trajectory, one.map, str(one.version)


def run_peers(peers: Sequence[Peer], rounds: int, progress: Callable[[int], None]) -> dict[str, PeerResult]:
    """Run each of the programs, in turns.

    Args:
        peers: the programs.
        rounds: how often.
        progress: called with the number of runs that are done.
    """
    times: dict[str, list[float]] = {peer.name: [] for peer in peers}
    found: dict[str, PeerResult] = {}
    done = 0
    for _ in range(rounds):
        for peer in peers:
            (outcome,) = make_all([_run(peer)], workers=1, timeout=peer.timeout, timed=True)
            done += 1
            progress(done)
            if outcome.status != "ok":
                error = without_folders(f"{outcome.status}: {outcome.error}")
                found[peer.name] = PeerResult(version=_version(peer), error=error)
                continue
            values = outcome.result["values"]
            times[peer.name].append(1e-3 * values["cpu_per_scan"]["value"])
            if not (peer.name in found and found[peer.name].error):
                ate = values["final.ate"].get("value")
                found[peer.name] = PeerResult(
                    version=_version(peer), processor=spread([[value] for value in times[peer.name]]), ate=ate
                )
    return found


def _version(peer: Peer) -> str:
    return str(peer.command[4]) if len(peer.command) > 4 else ""


def _run(peer: Peer) -> PlannedRun:
    return PlannedRun(
        scenario=SCENARIO,
        recording="",
        platform="",
        noise="",
        duration=DURATION,
        seed=SEED,
        configuration=peer.name,
        preset="",
        settings=(),
        varied=(),
        metrics=("final.ate",),
        command=peer.command,
    )
