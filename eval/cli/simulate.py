"""``moteslam simulate``: a scenario in, a recording and its truth out; of a batch, in many processes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import closing, contextmanager
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from moteslam.errors import ConfigError, MoteslamError
from moteslam.eval.cli import options
from moteslam.eval.cli.text import note, progress_bar, say, say_json, simulation_bar, table
from moteslam.eval.literal import literal

if TYPE_CHECKING:
    from moteslam.sim.logged import Logging
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Progress, Simulation

MAX_BATCH = 100_000
"""Simulations that one command makes at most."""


def simulate(
    scenario: options.ScenarioName,
    out: Annotated[Path, typer.Option(help=options.OUT)],
    seed: options.Seed = None,
    platform: options.Robot = None,
    noise: options.NoiseClass = None,
    settings: options.Settings = None,
    log_every: Annotated[
        float | None, typer.Option(metavar="M", help="Keep a scan only after M metres, or after --log-turn.")
    ] = None,
    log_turn: Annotated[
        float | None, typer.Option(metavar="RAD", help="Keep a scan only after this turn, or after --log-every.")
    ] = None,
    odometry_noise: Annotated[
        tuple[float, float] | None,
        typer.Option(metavar="DISTANCE ROTATION", help="Add these shares of noise to each step of the odometry."),
    ] = None,
    file_format: Annotated[
        Literal["ucsd", "carmen"], typer.Option("--format", metavar="ucsd|carmen", help="To write the recording in.")
    ] = "ucsd",
    batch: Annotated[
        int | None, typer.Option(min=1, max=MAX_BATCH, metavar="N", help="Make N, with seeds from --seed on.")
    ] = None,
    jobs: Annotated[
        int | None, typer.Option(min=1, max=1024, help="Processes of a batch; all cores by default.")
    ] = None,
    true_map: Annotated[
        float | None, typer.Option(metavar="M", help="Write the true map too, in cells of M metres.")
    ] = None,
    camera: Annotated[
        bool, typer.Option("--camera", help="Record colour and depth images, even if the scenario does not.")
    ] = False,
    force: options.Force = False,
    as_json: options.Json = False,
) -> None:
    """Simulate a scenario and write what is recorded.

    The folder has the UCSD layout, or a CARMEN log, with the truth beside it; of a batch, one such folder a seed.

    \b
    Examples:
      moteslam simulate corridor --out corridor --seed 3
      moteslam simulate office --platform turtlebot3 --set noise.lidar.dropout=0.1 --out small
      moteslam simulate big_loop --platform lms200 --log-every 0.75 --log-turn 0.5 --format carmen --out keys
      moteslam simulate random-corridors --out many --batch 20 --true-map 0.05
      moteslam simulate my_rooms.toml --out rooms
      moteslam simulate corridor --out coloured --camera
      moteslam replay corridor --out result
    """  # noqa: D301
    from moteslam.robot.files import result_folder
    from moteslam.sim.output import log_name, write_simulation

    if true_map is not None and not 0.001 <= true_map <= 10:
        raise ConfigError(f"{true_map:g} m, expected 0.001 to 10", field="--true-map")
    wanted = Wanted(
        scenario,
        platform=platform,
        noise=noise,
        settings=tuple(settings or ()),
        camera=camera,
        map_resolution=true_map,
        logging=_logging(log_every, log_turn, odometry_noise, file_format),
        file_format=file_format,
    )
    loaded = wanted.load(seed)
    if batch is not None:
        with result_folder(out, force=force) as folder:
            made = _make_batch(wanted, loaded, loaded.seed if seed is None else seed, batch, folder, jobs)
        if as_json:
            say_json({"out": str(out), "simulations": made})
            return
        rows = [("scenario", "seed", "distance [m]", "time [s]", "end")]
        for one in made:
            figures = (f"{one['distance_m']:.1f}", f"{one['duration_s']:.0f}")
            rows.append((literal(one["scenario"]), str(one["seed"]), *figures, one["end"]))
        say(table(rows, right=(1, 2, 3)))
        say(f"recordings and truths in {literal(out)}")
        return
    with result_folder(out, force=force) as folder, named_in_errors(scenario):
        with simulation_bar() as report:
            simulation = wanted.simulate(loaded, seed, report)
        with progress_bar("images", 1.0) as update:
            write_simulation(
                folder,
                simulation,
                map_resolution=true_map,
                file_format=file_format,
                announce=note,
                progress=lambda _what, share: update(share),
            )
    one = about(simulation)
    if as_json:
        say_json({"out": str(out), **one})
        return
    counts = ", ".join(f"{count} {name}" for name, count in one["readings"].items())
    distance = f"{one['distance_m']:.1f} m in {one['duration_s']:.0f} s ({one['end']})"
    say(f"{literal(loaded.name)}: {distance}; readings: {counts}")
    if file_format == "carmen":
        say(f"log in {literal(out / log_name(loaded.name))}, truth beside it")
    else:
        say(f"recording and truth in {literal(out)}")


@dataclass(frozen=True)
class Wanted:
    """What is to be simulated, and how it is recorded.

    Attributes:
        scenario: name of a bundled one, ``random-corridors``, or a path.
        platform: the robot in place of the scenario's own: a bundled one's name, or a file.
        noise: the class of its sensors' noise, in place of the scenario's own.
        settings: ``key=value`` over the scenario's.
        camera: record images, even if the scenario does not.
        map_resolution: of the true map [m]; None: it is not written.
        logging: what of the recording is logged; None: all, as the sensors gave it.
        file_format: in which it is written, ``ucsd`` or ``carmen``.
    """

    scenario: str
    platform: str | None = None
    noise: str | None = None
    settings: Sequence[str] = ()
    camera: bool = False
    map_resolution: float | None = None
    logging: Logging | None = None
    file_format: str = "ucsd"

    def load(self, seed: int | None) -> Scenario:
        """The scenario; ``random-corridors`` is the building of that seed.

        Raises:
            ConfigError: an unknown scenario or a broken one, a lidar that does not fit the format, or a wrong option,
                which is named.
        """
        from moteslam.robot.formats.written import expect_classic_fan
        from moteslam.sim.scenario import load_scenario, with_camera
        from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

        name = f"{self.scenario}-{seed or 0}" if self.scenario == RANDOM_CORRIDORS else self.scenario
        try:
            loaded = load_scenario(name, platform=self.platform, noise=self.noise, settings=self.settings)
        except ConfigError as error:
            field, problem = error.field, error.problem
            if field == "settings":
                option = "--set"
            elif field and self._sets(field):
                option = f"--set {field}"
            elif field == "noise_class" and self.noise is not None:
                option = "--noise"
            elif self.platform is not None and error.file is None and field in (self.platform, "platform"):
                option, problem = "--platform", f"{self.platform}: {problem}"
            else:
                raise
            raise ConfigError(problem, field=option) from error
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

    def _sets(self, field: str) -> bool:
        """Whether a setting is of this dotted key, of one below it, or of a table above it."""
        from moteslam.robot.tables import assigned, leaves

        keys = (f"{key}." for key in leaves(assigned(self.settings)))
        return any(key.startswith(f"{field}.") or f"{field}.".startswith(key) for key in keys)

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


@contextmanager
def named_in_errors(scenario: str) -> Iterator[None]:
    """Name the scenario, as the user wrote it, in errors that a run raises without a file."""
    try:
        yield
    except ConfigError as error:
        if error.file is not None:
            raise
        if error.field == "resolution":  # the only one that the command line sets
            raise ConfigError(error.problem, field="--true-map") from error
        raise ConfigError(error.problem, file=scenario, field=error.field) from error


def _logging(
    every: float | None, turn: float | None, noise: tuple[float, float] | None, file_format: str
) -> Logging | None:
    """What the command line asks to log; None: all that the sensors gave.

    Raises:
        ConfigError: a distance, turn or share out of bounds; the option is named.
    """
    if file_format == "ucsd" and every is None and turn is None and noise is None:
        return None
    from moteslam.sim.logged import Logging

    try:
        return Logging(every, turn, noise)
    except ConfigError as error:
        flags = {"every": "--log-every", "turn": "--log-turn", "noise": "--odometry-noise"}
        raise ConfigError(error.problem, field=flags[error.field or ""]) from error


def about(simulation: Simulation) -> dict[str, Any]:
    """The outcome of a simulation: scenario, seed, distance, time, end, and how many readings each stream has."""
    truth, recording = simulation.truth, simulation.recording
    readings = {
        name: len(stream) for name in ("lidar", "encoders", "imu") if (stream := getattr(recording, name)) is not None
    }
    if recording.rgbd is not None:
        readings |= {"rgb": len(recording.rgbd.rgb_stamps), "disparity": len(recording.rgbd.disparity_stamps)}
    return {
        "scenario": simulation.scenario.name,
        "seed": simulation.scenario.seed,
        "distance_m": truth.length,
        "duration_s": float(truth.stamps[-1] - truth.stamps[0]),
        "end": simulation.end,
        "readings": readings,
    }


@dataclass(frozen=True)
class _Job:
    """One simulation of a batch, for a process of its own."""

    wanted: Wanted
    seed: int
    folder: str

    @property
    def case(self) -> int:
        return self.seed

    def as_dict(self) -> dict[str, Any]:
        return asdict(self)


def _make_batch(
    wanted: Wanted, loaded: Scenario, first: int, count: int, folder: Path, processes: int | None
) -> list[dict[str, Any]]:
    """Make a number of simulations, with seeds from the first on; what ``about`` says of each, in their order.

    Raises:
        MoteslamError: the first that fails ends them all, and is named with its seed.
    """
    from moteslam.eval.sweep.workers import make_all
    from moteslam.robot.values import processor_count
    from moteslam.sim.output import file_name
    from moteslam.sim.scenario import MAX_SEED
    from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

    if first > (last := MAX_SEED - (count - 1)):
        raise ConfigError(f"{first}, expected at most {last} for {count} of them", field="--seed")
    name = file_name(wanted.scenario if wanted.scenario == RANDOM_CORRIDORS else loaded.name)
    todo = [_Job(wanted, seed, str(folder / f"{name}-{seed}")) for seed in range(first, first + count)]
    made: dict[int, dict[str, Any]] = {}
    outcomes = make_all(todo, workers=min(processes or processor_count(), count), module="moteslam.eval.cli.simulate")
    with closing(outcomes), progress_bar("batch", count, "runs") as update:
        for outcome in outcomes:
            if outcome.status != "ok":
                raise MoteslamError(outcome.error, file=wanted.scenario, field=f"seed {outcome.run.seed}")
            made[outcome.run.seed] = outcome.result
            update(len(made))
    return [made[job.seed] for job in todo]


def make(job: dict[str, Any], *, timed: bool = False) -> dict[str, Any]:
    """Simulate and write one of a batch, in a process of its own; what ``about`` says of it.

    Raises:
        MoteslamError: it cannot be simulated or written.
    """
    from moteslam.robot.files import make_folder
    from moteslam.sim.logged import Logging
    from moteslam.sim.output import write_simulation

    del timed
    table, seed, folder = job["wanted"], job["seed"], Path(job["folder"])
    logging = None if table["logging"] is None else Logging(**table["logging"])
    wanted = Wanted(**{**table, "logging": logging})
    simulation = wanted.simulate(wanted.load(seed), seed)
    make_folder(folder)
    write_simulation(folder, simulation, map_resolution=wanted.map_resolution, file_format=wanted.file_format)
    return about(simulation)
