"""The runs of a specification, each with a name that is the same on every computer, and what identifies them all."""

import hashlib
import json
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import islice, product
from pathlib import Path
from typing import Any

import tomli_w

from moteslam.errors import ConfigError, InputError, MoteslamError
from moteslam.eval.sweep.spec import MAX_RUNS, Configuration, Scalar, SweepSpec, numbers
from moteslam.plugins import code_of
from moteslam.robot.formats import format_of
from moteslam.robot.platforms import BASE, UCSD
from moteslam.robot.platforms import FOLDER as PLATFORMS
from moteslam.robot.values import Section, read_toml
from moteslam.sim.robot.driver import check_moves
from moteslam.sim.scenario import SCENARIOS, load_scenario
from moteslam.slam.config import resolve_config

WORDS = ("description", "why")  # Keys of scenarios and robots from which no run follows
ALONE = "configuration alone"
"""The column of the names of configurations, without what varies."""
COMMAND = ("command", "format", "trajectory", "map", "version")


class PlannedRun(Section):
    """One run of a sweep; two that are equal give the same result columns."""

    scenario: str  # Its name, or the path of its file; empty where a recording is replayed
    recording: str = ""  # Path of it; empty where a scenario is simulated
    platform: str = ""
    noise: str = ""  # In place of the scenario's own; empty for that
    duration: float | None = None  # The drive ends after this time [s]; None for the scenario's own
    seed: int  # Of simulation and SLAM
    configuration: str
    preset: str = ""
    settings: tuple[str, ...] = ()  # ``key=value`` over scenario, robot and preset, with their prefixes; sorted
    varied: tuple[tuple[str, Scalar], ...] = ()  # Keys and values of what varies, in the order of the specification
    metrics: tuple[str, ...] = ()
    command: tuple[tuple[str, ...] | str, ...] = ()
    """The fields ``COMMAND`` of a configuration with an external SLAM, the version where it has one; else empty."""

    @property
    def id(self) -> str:
        """Sixteen hexadecimal digits that follow from all of it."""
        return _hash(self.model_dump(mode="json"))[:16]

    @property
    def case(self) -> tuple[Any, ...]:
        """What the recording follows from: runs of the same case share one."""
        drawn = tuple(setting for setting in self.settings if not setting.startswith("slam."))
        return self.scenario, self.recording, self.platform, self.noise, self.duration, self.seed, drawn

    @property
    def name(self) -> str:
        parts = [self.scenario or Path(self.recording).name, self.platform, self.noise, f"seed {self.seed}"]
        return ", ".join(filter(None, [*parts, self.configured()]))

    def configured(self, *keys: str) -> str:
        """The configuration with what varies, some keys left out, or its own name."""
        named = [] if ALONE in keys else [self.configuration]
        return ", ".join([*named, *(f"{key}={value}" for key, value in self.varied if key not in keys)])

    @property
    def version(self) -> str:
        return str(self.command[4]) if len(self.command) > 4 else ""

    def for_slam(self) -> tuple[str, ...]:
        return tuple(setting.removeprefix("slam.") for setting in self.settings if setting.startswith("slam."))

    def for_scenario(self) -> tuple[str, ...]:
        """The settings over the scenario, those of its robot among them."""
        return tuple(setting.removeprefix("scenario.") for setting in self.settings if not setting.startswith("slam."))


def plan(spec: SweepSpec, *, check: bool = True) -> list[PlannedRun]:
    """All runs of a sweep, those of one case together.

    What scenario, robot or configuration would refuse is refused, unless they are not on this computer (``check``).
    """
    runs = list(islice(_runs(spec), MAX_RUNS + 1))
    if len(runs) > MAX_RUNS:
        raise ConfigError(f"more than {MAX_RUNS} runs, expected fewer seeds or values")
    times = Counter(run.id for run in runs)
    if twice := next((run.name for run in runs if times[run.id] > 1), ""):
        problem = f"the same run twice ({twice}), expected different scenarios, platforms, recordings and values"
        raise ConfigError(problem)
    if check:
        _check(runs)
    return runs


def shard(runs: list[PlannedRun], number: int, of: int) -> list[PlannedRun]:
    """The runs of one of several shards, each case in one of them: shard ``number`` from 1 on."""
    cases = {case: k for k, case in enumerate(dict.fromkeys(run.case for run in runs))}
    return [run for run in runs if cases[run.case] % of == number - 1]


def digest(runs: Sequence[PlannedRun]) -> str:
    """SHA-256 of what runs are, as 64 hexadecimal digits; two sweeps of the same have the same runs.

    Of the identities of the runs, of the tables of their scenarios and robots, descriptions and comments left out, and
    of the code of plug-ins of other packages. Moteslam's own code is not in it, nor are the presets, random buildings
    and the contents of recordings.
    """
    ids, cases = {run.id for run in runs}, {(run.scenario, run.platform) for run in runs}
    scenarios = {name: _table(name, SCENARIOS) for name in sorted({scenario for scenario, _ in cases})}
    robots: dict[str, Any] = {}

    def add(robot: Any, beside: Path) -> None:
        """The table of a robot, and of the one that it is based on; one within a scenario is in that already."""
        if isinstance(robot, str):
            name = str(beside / robot) if robot.endswith(".toml") else robot
            if name not in robots:
                robots[name] = _table(name, PLATFORMS)
                add(robots[name], beside)
        elif isinstance(robot, dict) and BASE in robot:
            add(robot[BASE], beside)

    for scenario, platform in sorted(cases):
        if scenario:
            add(platform or (scenarios[scenario] or {}).get("platform", UCSD.name), Path(scenario).parent)
    named = {setting.partition("=")[2].strip('"') for run in runs for setting in run.settings}
    code = code_of(named | {name.rpartition(".")[2] for run in runs for name in run.metrics})
    of_others = {"plug-ins": code} if code else {}
    return _hash({"runs": sorted(ids), "scenarios": scenarios, "platforms": robots} | of_others)


def _hash(value: dict[str, Any]) -> str:
    return hashlib.sha256(json.dumps(value, sort_keys=True, default=str).encode()).hexdigest()


def _table(name: str, folder: Path) -> dict[str, Any] | None:
    """The table of a bundled name or of a file; None for a random building, which has no file."""
    path = Path(name)
    if path.suffix != ".toml" and path.name == name:
        path = folder / f"{name}.toml"
        if not path.is_file():
            return None
    return {key: value for key, value in read_toml(path, "a .toml file").items() if key not in WORDS}


def _runs(spec: SweepSpec) -> Iterator[PlannedRun]:
    seeds = numbers(spec.seeds)
    simulated = product(spec.scenarios, ("",), spec.platforms or [""], spec.noise or [""], seeds)
    recorded = product(("",), spec.recordings, ("",), ("",), seeds)
    combinations = [dict(zip(spec.vary, values, strict=True)) for values in product(*map(spec.values, spec.vary))]
    # a command does not know keys of ours: it is run once for all of their values
    others = [{key: value for key, value in one.items() if not key.startswith("slam.")} for one in combinations]
    apart = list({tuple(one.items()): one for one in others}.values())
    for cases in (simulated, recorded):
        for case in cases:
            runs = [
                _run(spec, case, name, one, values)
                for name, one in spec.configurations.items()
                for values in (apart if one.command else combinations)
                # of one recording a command without a seed has one result
                if not one.command or case[0] or case[-1] == seeds[0] or "{seed}" in " ".join(one.command)
            ]
            order = {run.case: number for number, run in reversed([*enumerate(runs)])}
            yield from sorted(runs, key=lambda run: order[run.case])


def _run(
    spec: SweepSpec, case: tuple[str, str, str, str, int], name: str, one: Configuration, varied: dict[str, Scalar]
) -> PlannedRun:
    where: dict[str, Any] = dict(zip(("scenario", "recording", "platform", "noise", "seed"), case, strict=True))
    recording = where["recording"]
    settings = one.set | varied
    written = {key: tomli_w.dumps({"": value}).strip().partition("= ")[2] for key, value in settings.items()}
    command: tuple[tuple[str, ...] | str, ...] = ()
    if one.command:  # the version only where one was given: a run's name follows from these
        command = one.command, one.format, one.trajectory, one.map, *([str(one.version)] if one.version else [])
    return PlannedRun(
        **where,
        duration=None if recording else spec.duration,
        configuration=name,
        preset=one.preset,
        settings=tuple(sorted(map("=".join, written.items()))),
        varied=tuple(varied.items()),
        metrics=spec.metrics,
        command=command,
    )


def _check(runs: list[PlannedRun]) -> None:
    seen: set[Any] = set()
    for run in runs:
        slam, world = (run.preset, run.for_slam()), run.case[:4] + run.case[6:]
        if slam not in seen:
            with _named(f"configurations.{run.configuration}", run):
                resolve_config(run.preset, run.for_slam())
        if world not in seen and run.scenario:
            platform, noise = run.platform or None, run.noise or None
            with _named(f"scenarios, {Path(run.scenario).name}", run):
                scenario = load_scenario(run.scenario, platform=platform, noise=noise, settings=run.for_scenario())
            with _named("duration", run):
                check_moves(scenario.drive, run.duration or scenario.duration)
        if world not in seen and run.recording:
            try:
                format_of(run.recording)
            except InputError as error:
                raise ConfigError(f"{run.recording!r} {error.problem}", field="recordings") from error
        seen |= {slam, world}


@contextmanager
def _named(where: str, run: PlannedRun) -> Iterator[None]:
    """Errors of the block name a place of the specification: what varies of a run, its robot, else as given."""
    try:
        yield
    except MoteslamError as error:
        problem, field = error.problem, error.field or ""
        file = error.file if error.file is not None and Path(error.file).exists() else None  # not a bundled one's name
        if varied := [key for key, _ in run.varied if field and key.partition(".")[2].endswith(field)]:
            where = f"vary.{varied[0]}"
        elif run.platform and run.platform in (field, None if file else error.file):
            where, problem = "platforms", f"{run.platform!r}, {problem}"
        elif field and field not in where:
            where = f"{where}, {field}"
        raise ConfigError(problem, file=file, field=where) from error
