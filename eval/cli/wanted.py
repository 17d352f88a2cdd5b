"""What a command is to simulate: the scenario, and all that the command line changes of it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING

from moteslam.errors import ConfigError

if TYPE_CHECKING:
    from moteslam.sim.logged import Logging
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Progress, Simulation

MAX_BATCH = 100_000
"""Simulations that one command makes at most."""

_LOGGING = {"every": "--log-every", "turn": "--log-turn", "noise": "--odometry-noise"}
"""The options that set the fields of ``Logging``."""


@dataclass(frozen=True)
class Wanted:
    """What is to be simulated, and how it is recorded.

    Attributes:
        scenario: name of a bundled one, ``random-corridors``, or a path.
        platform: the robot in place of the scenario's own: a bundled one's name, or a file.
        noise: the class of its sensors' noise, in place of the scenario's own.
        settings: ``key=value`` over the scenario's.
        camera: record images, even if the scenario does not.
        map_resolution: of the true map [m], None for none.
        logging: what of the recording is logged; all, as the sensors gave it, where it is None.
        file_format: in which it is written, ``ucsd`` or ``carmen``.
    """

    scenario: str
    platform: str | None = None
    noise: str | None = None
    settings: tuple[str, ...] = ()
    camera: bool = False
    map_resolution: float | None = None
    logging: Logging | None = None
    file_format: str = "ucsd"

    def load(self, seed: int | None) -> Scenario:
        """The scenario; ``random-corridors`` is the building of that seed.

        Raises:
            ConfigError: there is none, it is not well made, its lidar does not fit the format, or an option that
                changes it is wrong; that one is named.
        """
        from moteslam.robot.formats.carmen_writer import expect_classic_fan
        from moteslam.robot.tables import assigned, leaves
        from moteslam.sim.scenario import load_scenario, with_camera
        from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

        name = f"{self.scenario}-{seed or 0}" if self.scenario == RANDOM_CORRIDORS else self.scenario
        try:
            loaded = load_scenario(name, platform=self.platform, noise=self.noise, settings=self.settings)
        except ConfigError as error:
            if error.field == "settings":
                raise ConfigError(error.problem, field="--set") from error
            if error.field and any(_begins(key, error.field) for key in leaves(assigned(self.settings))):
                raise ConfigError(error.problem, field=f"--set {error.field}") from error
            if error.field == "noise_class" and self.noise is not None:
                raise ConfigError(error.problem, field="--noise") from error
            if self.platform is not None and error.file is None and error.field in (self.platform, "platform"):
                raise ConfigError(f"{self.platform}: {error.problem}", field="--platform") from error
            raise
        if self.file_format == "carmen":
            scan = loaded.platform.lidar.scan
            try:
                expect_classic_fan(scan.beams, scan.angle_min, scan.angle_increment)
            except ConfigError as error:
                raise ConfigError(error.problem, field="--format") from error
        if not self.camera:
            return loaded
        with named_in_errors(self.scenario):
            return with_camera(loaded)

    def simulate(self, loaded: Scenario, seed: int | None, progress: Progress | None = None) -> Simulation:
        """Simulate the scenario, as ``load(seed)`` gives it, and log it.

        Raises:
            ConfigError: a robot that gets stuck on its route.
            InputError: no scans or no encoder readings are left to log.
        """
        from moteslam.sim.logged import logged
        from moteslam.sim.simulate import simulate

        simulation = simulate(loaded, seed, progress=progress)
        return simulation if self.logging is None else logged(simulation, self.logging)


def logging_of(
    every: float | None, turn: float | None, noise: tuple[float, float] | None, *, file_format: str
) -> Logging | None:
    """What the command line asks to log; None where that is all that the sensors gave.

    Raises:
        ConfigError: a distance, turn or share out of bounds; the option is named.
    """
    if file_format == "ucsd" and every is None and turn is None and noise is None:
        return None
    from moteslam.sim.logged import Logging

    try:
        return Logging(every, turn, noise)
    except ConfigError as error:
        raise ConfigError(error.problem, field=_LOGGING[error.field or ""]) from error


def _begins(key: str, field: str) -> bool:
    """Whether one of two dotted keys is the other, or a table above it."""
    return f"{key}.".startswith(f"{field}.") or f"{field}.".startswith(f"{key}.")


@contextmanager
def named_in_errors(scenario: str) -> Iterator[None]:
    """Name the scenario, as the user wrote it, in what a run finds wrong with it."""
    try:
        yield
    except ConfigError as error:
        if error.file is not None:
            raise
        if error.field == "resolution":  # the only one that the command line sets
            raise ConfigError(error.problem, field="--true-map") from error
        raise ConfigError(error.problem, file=scenario, field=error.field) from error
