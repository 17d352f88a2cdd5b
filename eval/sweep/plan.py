"""The runs of a specification, each with a name that is the same on every computer."""

from __future__ import annotations

import hashlib
import json
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from itertools import islice, product
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError, InputError, MoteslamError
from moteslam.eval.sweep.spec import MAX_RUNS, Configuration, Scalar, SweepSpec, numbers


@dataclass(frozen=True)
class PlannedRun:
    """One run of a sweep; two that are equal give the same result columns.

    Attributes:
        scenario: its name, or the path of its file; empty where a recording is replayed.
        recording: path of it; empty where a scenario is simulated.
        platform, noise: in place of the scenario's own; empty for that.
        duration: the drive ends after this time [s]; None for the scenario's own.
        seed: of simulation and SLAM.
        configuration: its name.
        preset: that it starts from.
        settings: ``key=value`` over scenario, robot and preset, with their prefixes; sorted.
        varied: keys and values of what varies, in the order of the specification.
        metrics: what is measured.
        command: an external SLAM in place of the preset: see ``Command``; empty for none.
    """

    scenario: str
    recording: str
    platform: str
    noise: str
    duration: float | None
    seed: int
    configuration: str
    preset: str
    settings: tuple[str, ...]
    varied: tuple[tuple[str, Scalar], ...]
    metrics: tuple[str, ...]
    command: tuple[Any, ...] = ()

    @property
    def id(self) -> str:
        """Sixteen hexadecimal digits that follow from all of it."""
        text = json.dumps(asdict(self), sort_keys=True, allow_nan=False)
        return hashlib.sha256(text.encode()).hexdigest()[:16]

    @property
    def case(self) -> tuple[Any, ...]:
        """What the recording follows from: runs of the same case share one."""
        drawn = tuple(setting for setting in self.settings if not setting.startswith("slam."))
        return self.scenario, self.recording, self.platform, self.noise, self.duration, self.seed, drawn

    @property
    def name(self) -> str:
        """For people: what it is in one line."""
        parts = [self.scenario or Path(self.recording).name, self.platform, self.noise, f"seed {self.seed}"]
        return ", ".join(filter(None, [*parts, self.configured]))

    @property
    def configured(self) -> str:
        """For people: the configuration, with what varies."""
        return ", ".join([self.configuration, *(f"{key}={value}" for key, value in self.varied)])

    @property
    def version(self) -> str:
        """Of the external SLAM, where one was given."""
        return str(self.command[4]) if len(self.command) > 4 else ""

    def for_slam(self) -> tuple[str, ...]:
        """The settings over the preset."""
        return tuple(setting.removeprefix("slam.") for setting in self.settings if setting.startswith("slam."))

    def for_scenario(self) -> tuple[str, ...]:
        """The settings over the scenario, those of its robot among them."""
        return tuple(setting.removeprefix("scenario.") for setting in self.settings if not setting.startswith("slam."))

    def as_dict(self) -> dict[str, Any]:
        """As JSON has it."""
        return asdict(self)

    @classmethod
    def of(cls, table: dict[str, Any]) -> PlannedRun:
        """From what ``as_dict`` gave."""
        tuples = {name: tuple(table[name]) for name in ("settings", "metrics")}
        tuples["command"] = tuple(tuple(part) if isinstance(part, list) else part for part in table["command"])
        varied = tuple((key, value) for key, value in table["varied"])
        return cls(**{**table, **tuples, "varied": varied})


def plan(spec: SweepSpec, *, check: bool = True) -> list[PlannedRun]:
    """All runs of a sweep, those of one case together.

    Args:
        spec: of the sweep.
        check: refuse what scenario, robot or configuration would refuse; where they are not on this computer, do not.

    Raises:
        ConfigError: more than ``MAX_RUNS``, two that are the same, or one of which a key or value is refused: by
            scenario, robot or configuration.
    """
    if spec.recordings and (others := [key for key in spec.vary if not key.startswith("slam.")]):
        raise ConfigError("of a scenario, expected slam. keys alone where recordings are replayed", field=others[0])
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
    cases: dict[tuple[Any, ...], int] = {}
    for run in runs:
        cases.setdefault(run.case, len(cases))
    return [run for run in runs if cases[run.case] % of == number - 1]


def _runs(spec: SweepSpec) -> Iterator[PlannedRun]:
    seeds = numbers(spec.seeds)
    simulated = product(spec.scenarios, ("",), spec.platforms or [""], spec.noise or [""], seeds)
    recorded = product(("",), spec.recordings, ("",), ("",), seeds)
    combinations = list(product(*(spec.values(key) for key in spec.vary)))
    outer = [k for k, key in enumerate(spec.vary) if key.startswith("slam.")]
    for cases in (simulated, recorded):
        for scenario, recording, platform, noise, seed in cases:
            runs = [
                _run(spec, (scenario, recording, platform, noise, seed), name, one, values)
                for name, one in spec.configurations.items()
                for values in combinations
                # a command knows no keys of ours: it is run once for all of their values
                if not one.command or all(values[k] == spec.values(list(spec.vary)[k])[0] for k in outer)
            ]
            yield from sorted(runs, key=lambda run: run.case)


def _run(
    spec: SweepSpec, case: tuple[str, str, str, str, int], name: str, one: Configuration, values: tuple[Scalar, ...]
) -> PlannedRun:
    scenario, recording, platform, noise, seed = case
    varied = tuple(
        (key, value)
        for key, value in zip(spec.vary, values, strict=True)
        if not (one.command and key.startswith("slam."))
    )
    settings = {**one.set, **dict(varied)}
    if recording:
        settings = {key: value for key, value in settings.items() if key.startswith("slam.")}
    return PlannedRun(
        scenario=scenario,
        recording=recording,
        platform=platform,
        noise=noise,
        duration=None if recording else spec.duration,
        seed=seed,
        configuration=name,
        preset=one.preset,
        settings=tuple(sorted(f"{key}={_literal(value)}" for key, value in settings.items())),
        varied=varied,
        metrics=tuple(spec.metrics),
        command=_command(one),
    )


def _command(one: Configuration) -> tuple[Any, ...]:
    """The fields of a ``Command``, the version only where one was given: a run's name follows from them."""
    if not one.command:
        return ()
    fields = one.command, one.format, one.trajectory, one.map
    return (*fields, one.version) if one.version else fields


def _literal(value: Any) -> str:
    """A value as TOML writes it."""
    import tomli_w

    return tomli_w.dumps({"value": value}).strip().partition("= ")[2]


def _check(runs: list[PlannedRun]) -> None:
    """Refuse what a run would refuse, before the first begins."""
    from moteslam.robot.formats import format_of
    from moteslam.sim.scenario import load_scenario
    from moteslam.slam.settings import resolve_config

    seen: set[Any] = set()
    for run in runs:
        slam = run.preset, run.for_slam()
        world = run.case[:4] + run.case[6:]
        if slam not in seen:
            with _named(f"configurations.{run.configuration}", run):
                resolve_config(run.preset, run.for_slam())
        if world not in seen and run.scenario:
            with _named(f"scenarios, {Path(run.scenario).name}", run):
                load_scenario(
                    run.scenario,
                    platform=run.platform or None,
                    noise=run.noise or None,
                    settings=run.for_scenario(),
                )
        if world not in seen and run.recording:
            if not Path(run.recording).exists():
                raise ConfigError(f"{run.recording!r}, which there is not, expected a recording", field="recordings")
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
        problem = error.problem
        named = [key for key, _ in run.varied if error.field and key.partition(".")[2].endswith(error.field)]
        if named:
            field = f"vary.{named[0]}"
        elif run.platform and error.field == run.platform:
            field, problem = "platforms", f"{run.platform!r}, {problem}"
        else:
            field = f"{where}, {error.field}" if error.field and error.field not in where else where
        file = error.file if error.file is not None and Path(error.file).exists() else None  # not a bundled one's name
        raise ConfigError(problem, file=file, field=field) from error
