"""``moteslam simulate``: a scenario in, a recording and its truth out; of a batch, in many processes."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from dataclasses import dataclass
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

from moteslam.errors import ConfigError, MoteslamError, in_file
from moteslam.eval.cli import options
from moteslam.eval.cli.options import flag, opt
from moteslam.eval.cli.text import answer, note, progress_bar, simulation_bar
from moteslam.eval.tables import Column, aligned, literal, rows_of

if TYPE_CHECKING:
    from moteslam.sim.logged import Logging
    from moteslam.sim.scenario import Scenario
    from moteslam.sim.simulate import Progress, Simulation

MAX_BATCH = 100_000  # Simulations that one command makes at most
BATCH = (
    *(Column("scenario", "scenario"), Column("seed", "seed"), Column("distance [m]", "distance_m", ".1f")),
    *(Column("time [s]", "duration_s", ".0f"), Column("end", "end")),
)


@dataclass(frozen=True)
class Recorded:
    """Which robot drives, and what is recorded of it and written: each field is an option."""

    platform: options.Robot = None
    noise: options.NoiseClass = None
    settings: options.Settings = None
    duration: Annotated[float | None, opt("Stop the drive after S seconds.", "S", min=1)] = None
    log_every: Annotated[float | None, opt("Keep only scans M metres, or --log-turn, apart.", "M")] = None
    log_turn: Annotated[float | None, opt("Keep only scans this turn, or --log-every, apart.", "RAD")] = None
    odometry_noise: Annotated[
        tuple[float, float] | None, opt("Add these shares of noise to each step of the odometry.", "DISTANCE ROTATION")
    ] = None
    file_format: Annotated[Literal["ucsd", "carmen"], opt("Format of the recording.", "ucsd|carmen", "--format")] = (
        "ucsd"
    )
    true_map: Annotated[float | None, opt("Also write the true map, in cells of M metres.", "M")] = None
    camera: Annotated[bool, flag("--camera", "Record colour and depth images, even if the scenario does not.")] = False

    def logging(self) -> Logging:
        from moteslam.sim.logged import Logging

        with options.named(every="--log-every", turn="--log-turn", noise="--odometry-noise"):
            return Logging(self.log_every, self.log_turn, self.odometry_noise)

    def scenario(self, name: str, seed: int | None) -> Scenario:
        """The scenario of a name, as it is to be driven; what of it cannot be recorded as asked for is refused."""
        from moteslam.sim.scenario import with_camera

        self.logging()
        more: dict[str, Any] = {"settings": self.settings or (), "duration": self.duration}
        loaded = scenario_of(name, seed, platform=self.platform, noise=self.noise, **more)
        with in_file(name):
            return with_camera(loaded) if self.camera else loaded

    def simulate(self, scenario: Scenario, seed: int | None, progress: Progress | None = None) -> Simulation:
        """Drive the scenario and log what is asked for, by default all that the sensors gave."""
        from moteslam.sim.logged import Logging, logged
        from moteslam.sim.simulate import simulate

        logging = self.logging()
        simulation = simulate(scenario, seed, progress=progress)
        as_sensed = self.file_format == "ucsd" and logging == Logging()
        return simulation if as_sensed else logged(simulation, logging)


@options.with_options(recorded=Recorded)
def simulate(
    scenario: options.ScenarioName,
    out: Annotated[Path, opt(options.OUT)],
    seed: options.Seed = None,
    batch: Annotated[int | None, opt("Make N recordings, seeds from --seed on.", "N", min=1, max=MAX_BATCH)] = None,
    jobs: Annotated[int | None, opt("Parallel processes of a batch; all cores by default.", min=1, max=1024)] = None,
    force: options.Force = False,
    as_json: options.Json = False,
    *,
    recorded: Recorded,
) -> None:
    """Simulate a scenario and write what is recorded.

    The folder has the UCSD layout, or a CARMEN log, with the truth beside it; of a batch, one such folder a seed.

    \b
    Examples:
      moteslam simulate corridor --out corridor --seed 3
      moteslam simulate office --platform turtlebot3 --set noise.lidar.dropout=0.1 --out small
      moteslam simulate big_loop --platform lms200 --log-every 0.75 --log-turn 0.5 --format carmen --out keys
      moteslam simulate random-corridors --out many --batch 20 --true-map 0.05
    """  # noqa: D301
    from moteslam.files import result_folder
    from moteslam.sim.output import log_name, write_simulation

    if recorded.true_map is not None and not 0.001 <= recorded.true_map <= 10:
        raise ConfigError(f"{recorded.true_map:g} m, expected 0.001 to 10", field="--true-map")
    loaded = recorded.scenario(scenario, seed)
    if batch is not None:
        with result_folder(out, force=force) as folder:
            made = _make_batch(scenario, recorded, loaded, loaded.seed if seed is None else seed, batch, folder, jobs)
        lines = [aligned(rows_of(BATCH, made)), f"recordings and truths in {literal(out)}"]
        answer({"out": str(out), "simulations": made}, lines, as_json=as_json)
        return
    with result_folder(out, force=force) as folder, in_file(scenario), options.named(resolution="--true-map"):
        with simulation_bar() as report:
            simulation = recorded.simulate(loaded, seed, report)
        with progress_bar("images", 1.0) as update:
            how: dict[str, Any] = {"map_resolution": recorded.true_map, "file_format": recorded.file_format}
            write_simulation(folder, simulation, **how, announce=note, progress=lambda _what, share: update(share))
    found = {"out": str(out), **about(simulation)}
    counts = ", ".join(f"{count} {name}" for name, count in found["readings"].items())
    distance = f"{found['distance_m']:.1f} m in {found['duration_s']:.0f} s ({found['end']})"
    where = f"recording and truth in {literal(out)}"
    if recorded.file_format == "carmen":
        where = f"log in {literal(out / log_name(found['scenario']))}, truth beside it"
    answer(found, [f"{literal(found['scenario'])}: {distance}; readings: {counts}", where], as_json=as_json)


def scenario_of(
    name: str,
    seed: int | None,
    *,
    platform: str | None = None,
    noise: str | None = None,
    settings: Sequence[str] = (),
    duration: float | None = None,
) -> Scenario:
    """A scenario, with ``random-corridors`` as the building of that seed; the drive ends after ``duration`` [s]."""
    from moteslam.sim.scenario import load_scenario
    from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

    numbered = f"{name}-{seed or 0}" if name == RANDOM_CORRIDORS else name
    flags = {} if platform is None else dict.fromkeys(("platform", platform), f"--platform {platform}")
    try:
        with options.named(settings="--set", **flags):
            loaded = load_scenario(numbered, platform=platform, noise=noise, settings=settings)
    except ConfigError as error:
        stated = dict(one.partition("=")[::2] for one in settings).get("duration")
        if error.field != "duration" or stated is None:
            raise
        why = f"to stop earlier use --duration {stated} (duration={stated} is longer for a slower robot)"
        raise ConfigError(f"{error.problem}; {why}", file=error.file, field=error.field) from error
    return loaded.model_copy(update={"duration": min(inf if duration is None else duration, loaded.duration)})


def about(simulation: Simulation) -> dict[str, Any]:
    """The outcome of a simulation: scenario, seed, distance, time, end, and how many readings each stream has."""
    truth, streams = simulation.truth, simulation.recording.stamps()
    return {
        "scenario": simulation.scenario.name,
        "seed": simulation.scenario.seed,
        "distance_m": truth.length,
        "duration_s": float(truth.stamps[-1] - truth.stamps[0]),
        "end": simulation.end,
        "readings": {name: len(stamps) for name, stamps in streams.items() if name != "odometry"},
    }


@dataclass(frozen=True)
class _Job:
    """One simulation of a batch, for a process of its own; the case is its seed."""

    scenario: str
    recorded: Recorded
    case: int
    folder: str


def _make_batch(
    scenario: str, recorded: Recorded, loaded: Scenario, first: int, count: int, folder: Path, processes: int | None
) -> list[dict[str, Any]]:
    from moteslam.eval.sweep.workers import make_all
    from moteslam.robot.values import processor_count
    from moteslam.sim.output import file_name
    from moteslam.sim.scenario import MAX_SEED
    from moteslam.sim.world.random_corridors import NAME as RANDOM_CORRIDORS

    if first > (last := MAX_SEED - (count - 1)):
        raise ConfigError(f"{first}, expected at most {last} for {count} of them", field="--seed")
    name = file_name(scenario if scenario == RANDOM_CORRIDORS else loaded.name)
    seeds = range(first, first + count)
    todo = [_Job(scenario, recorded, seed, str(folder / f"{name}-{seed}")) for seed in seeds]
    made: dict[int, dict[str, Any]] = {}
    outcomes = make_all(todo, workers=min(processes or processor_count(), count), module="moteslam.eval.cli.simulate")
    with closing(outcomes), progress_bar("batch", count, "runs") as update:
        for outcome in outcomes:
            if outcome.status != "ok":
                raise MoteslamError(outcome.error, file=scenario, field=f"seed {outcome.run.case}")
            made[outcome.run.case] = outcome.result
            update(len(made))
    return [made[seed] for seed in seeds]


def make(job: dict[str, Any], *, timed: bool = False) -> dict[str, Any]:
    """Simulate and write one of a batch, in a process of its own; what ``about`` says of it."""
    from moteslam.sim.output import write_simulation

    del timed
    recorded, seed = Recorded(**job["recorded"]), job["case"]
    simulation = recorded.simulate(recorded.scenario(job["scenario"], seed), seed)
    how: dict[str, Any] = {"map_resolution": recorded.true_map, "file_format": recorded.file_format}
    write_simulation(job["folder"], simulation, **how)
    return about(simulation)
