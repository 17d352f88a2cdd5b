"""The specification of a sweep: which runs there are to make, as a TOML file says it."""

import os
import re
import subprocess
from collections.abc import Collection, Sequence
from difflib import get_close_matches
from pathlib import Path
from typing import Annotated, Any, Literal, Self

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Discriminator, Field, Tag, model_validator

from moteslam.errors import ConfigError, InputError, in_file
from moteslam.eval.metrics.evidence import TRACKS
from moteslam.eval.metrics.registry import chosen, split
from moteslam.eval.tables import shortened
from moteslam.robot.values import NotNegative, Number, Positive, Section, Whole, read_toml, validated
from moteslam.slam.config import DEFAULT_PRESET, PRESETS

FOLDER = Path(__file__).parent / "specs"
MAX_RUNS = 1_000_000
TAIL, LONGEST_VERSION = 300, 200
"""Characters of the last line that a program printed that go into the error, and of a version."""
PREFIXES = ("slam.", "scenario.", "platform.")
"""What a key that varies, or that a configuration sets, begins with: whose key it is."""
SUCCESS = {"final.ate": 0.5}
"""A run succeeds, where nothing else is said, with a final ATE of at most this [m]."""

Scalar = bool | int | float | str


def _named(text: str) -> str:
    if not re.fullmatch(r"[\w.+-]{1,80}", text):
        raise ValueError(f"{shortened(text, 90)!r}, expected letters, digits, _ . + -, at most 80")
    return text


Name = Annotated[str, AfterValidator(_named)]


def _listed(value: Any) -> Any:
    """A list, also where one value is given."""
    return [value] if isinstance(value, Scalar) else value


Strings = Annotated[tuple[str, ...], BeforeValidator(_listed)]
NoiseClasses = Annotated[tuple[Literal["datasheet", "as_recorded"], ...], BeforeValidator(_listed)]


class Range(Section):
    """Numbers from the first to the last of them, evenly spaced, or each the same factor above the one before."""

    first: Number
    last: Number
    steps: Annotated[Whole, Field(ge=2, le=10_000)]
    spacing: Literal["even", "factor"] = "even"

    @model_validator(mode="after")
    def _fits(self) -> Self:
        if self.spacing == "factor" and not (self.first > 0 and self.last > 0):
            raise ValueError("first and last, expected above 0 where spacing is factor")
        return self

    def values(self) -> list[int] | list[float]:
        """The numbers; whole ones as such, for keys that take no others."""
        spaced = np.geomspace if self.spacing == "factor" else np.linspace
        values = [float(f"{number:.12g}") for number in spaced(self.first, self.last, self.steps)]
        return [int(value) for value in values] if all(value.is_integer() for value in values) else values


def _plain(value: Any) -> Any:
    values = value if isinstance(value, list | tuple) else [value]
    if isinstance(value, dict | Range) or (values and all(isinstance(one, Scalar) for one in values)):
        return value
    expected = "a list of numbers, of words, or of true and false, or a range { first, last, steps }"
    raise ValueError(f"{shortened(repr(value), 90)}, expected {expected}")


Values = Annotated[
    Annotated[tuple[Scalar, ...], BeforeValidator(_listed), Tag("values")] | Annotated[Range, Tag("range")],
    Discriminator(lambda value: "range" if isinstance(value, dict | Range) else "values"),
    BeforeValidator(_plain),
]
"""What a key takes: a list of values, or a range."""


def flat(table: dict[str, Any], prefix: str = "", *, whole: Collection[str] = ()) -> dict[str, Any]:
    """A table within tables as one of dotted keys; one with any of the keys ``whole`` is a value."""
    found: dict[str, Any] = {}
    for name, value in table.items():
        within = isinstance(value, dict) and value.keys().isdisjoint(whole)
        found |= flat(value, f"{prefix}{name}.", whole=whole) if within else {f"{prefix}{name}": value}
    return found


def _dotted(table: Any) -> Any:
    if not isinstance(table, dict):
        return table
    found = flat(table, whole=Range.model_fields)
    if wrong := [key for key in found if not key.startswith(PREFIXES) or key.endswith(".")]:
        raise ValueError(f"{wrong[0]!r}, expected slam.{wrong[0]}, say: keys begin with {', '.join(PREFIXES)}")
    return found


OVER = {"platforms": "scenario.platform", "noise": "scenario.noise_class", "duration": "scenario.duration"}
"""What of the scenarios a sweep changes for all configurations, and by which key one of these would."""
PLACES = ("recording", "platform", "out", "seed", "here")  # What stands in braces in a command


class Configuration(Section):
    """A way to run SLAM: a preset of ours, or a command of anyone's."""

    preset: str = DEFAULT_PRESET  # The preset that it starts from
    command: tuple[str, ...] = ()
    """In place of a preset: a program and its arguments. In each `{recording}` stands for the file or folder of the
    recording, `{platform}` for its robot as TOML, `{out}` for an empty folder, `{seed}` for the seed, `{here}` for the
    folder of this file.
    """
    version: str | tuple[str, ...] = ""
    """Of the command: a text, or a program and its arguments, the first line of which is recorded."""
    format: Literal["carmen", "ucsd"] = "carmen"  # In which the command is given the recording
    trajectory: Name = "trajectory.tum"  # Which file in `{out}` is the command's trajectory, on the recording's clock
    map: Name = "map.yaml"  # Which file in `{out}` is its map, if it writes one, in the trajectory's frame
    set: Annotated[dict[str, Any], BeforeValidator(_dotted)] = Field(default_factory=dict)
    """Keys over it: `slam.` of the preset, `scenario.` of the scenario, `platform.` of its robot."""

    @model_validator(mode="after")
    def _either(self) -> Self:
        given = self.model_fields_set
        if self.command and "preset" in given:
            raise ValueError("preset and command, expected one of the two")
        if not self.command and (extra := given & {"version", "format", "trajectory", "map"}):
            raise ValueError(f"{sorted(extra)[0]} without a command")
        for word in re.findall(r"(?<!\$)\{([a-z_]+)\}", " ".join(self.command)):
            if word not in PLACES and (meant := get_close_matches(word, PLACES, n=1, cutoff=0.5)):
                raise ValueError(f"{{{word}}} in the command, expected {{{meant[0]}}}")
        if self.command and any(key.startswith("slam.") for key in self.set):
            raise ValueError("slam. keys with a command, expected those of scenario and platform alone")
        return self


def _counted(seeds: Any) -> str:
    """Seeds as a text; a list of them is one, too."""
    if isinstance(seeds, list) and seeds and all(type(seed) is int for seed in seeds):
        seeds = ",".join(map(str, seeds))
    if not isinstance(seeds, str):
        ways = f'"0-{seeds - 1}" for {seeds} of them, "{seeds}" for this, ' if type(seeds) is int and seeds > 1 else ""
        raise ValueError(f'{seeds!r}, expected a text: {ways}"3,5,10-19", or a list of numbers')
    numbers(seeds)
    return seeds


class SweepSpec(Section):
    """A sweep: every configuration, with every combination of what varies, on every case and every seed."""

    name: Name = "sweep"  # Of the sweep
    description: str = ""  # What it is for, one sentence; no run follows from it
    scenarios: Strings = ()  # Names of bundled ones, or paths of TOML files, beside this one
    recordings: Strings = ()
    """Paths of recordings, beside this file; with a truth or a reference beside them they are scored by it.

    ``${NAME}`` in a path stands for that variable of the environment.
    """
    platforms: Strings = ()  # Robots in place of the scenarios' own: names, or paths of TOML files
    noise: NoiseClasses = ()  # Classes of noise in place of the scenarios' own
    duration: Positive | None = None  # The drives end after this time, if not before [s]
    seeds: Annotated[str, BeforeValidator(_counted)] = "0-9"
    """Of the simulation and of SLAM: `0-9`, `3,5,10-19`, or a list."""
    configurations: dict[Name, Configuration] = Field(
        default_factory=lambda: {"default": Configuration()}, min_length=1
    )
    """By name."""
    vary: Annotated[dict[str, Values], BeforeValidator(_dotted)] = Field(default_factory=dict)
    """Keys that take these values, in every combination."""
    metrics: Strings = ()  # What is measured, by name; all metrics that are not costly by default
    success: dict[str, NotNegative] = Field(default_factory=lambda: dict(SUCCESS))
    """A run succeeds if each of these metrics is present and at most this large."""
    timeout: Positive = 1800.0  # A run that takes longer has failed [s]

    @model_validator(mode="after")
    def _cases(self) -> Self:
        if not self.scenarios and not self.recordings:
            raise ValueError("neither scenarios nor recordings, expected some of either")
        if not self.scenarios and (given := [name for name in OVER if getattr(self, name)]):
            raise ValueError(f"{given[0]} without scenarios, expected them to be what it changes")
        keys = [key for table in (self.vary, *(one.set for one in self.configurations.values())) for key in table]
        for name, key in OVER.items():
            if getattr(self, name) and key in keys:
                raise ValueError(f"{name} and {key}, expected one of the two")
        for name, one in self.configurations.items():
            if name in PRESETS and not one.command and one.preset != name:
                expected = f'expected preset = "{name}", or another name'
                raise ValueError(f"configurations.{name}: of the preset {one.preset}, {expected}")
        if self.recordings and (others := [key for key in keys if not key.startswith("slam.")]):
            raise ValueError(f"{others[0]}, expected slam. keys alone where recordings are replayed")
        return self

    def values(self, key: str) -> list[Scalar]:
        given = self.vary[key]
        return [*given.values()] if isinstance(given, Range) else [*given]


def bundled_specs() -> dict[str, Path]:
    """The files of the specifications that come with the package, by name."""
    return {path.stem: path for path in sorted(FOLDER.glob("*.toml"))}


def spec_file(name: str) -> Path:
    """The file of a specification: a bundled one by its name, or a path."""
    path, bundled = Path(name), bundled_specs()
    if name in bundled:
        return bundled[name]
    if path.suffix == ".toml" or path.is_file():
        return path
    problem = f"no specification of this name, expected one of {', '.join(bundled)}, or a .toml file"
    raise ConfigError(problem, file=name)


def read_spec(path: Path) -> SweepSpec:
    """Read a specification; paths in it are made absolute, and versions of commands are asked for."""
    spec = validated(SweepSpec, read_toml(path, "a sweep's .toml file"), file=path)
    beside = path.absolute().parent

    def seen(names: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(str(beside / name) if name.endswith(".toml") or "/" in name else name for name in names)

    with in_file(path):
        for name in chosen([*spec.metrics, *spec.success]):
            track, short = split(name)
            if track and track not in TRACKS:
                expected = ", ".join(f"{each}.{short}" for each in TRACKS)
                raise ConfigError(f"{name!r}, expected one of {expected}", field="metrics")
        return spec.model_copy(
            update={
                "scenarios": seen(spec.scenarios),
                "platforms": seen(spec.platforms),
                "recordings": tuple(str(beside / _expanded(name)) for name in spec.recordings),
                "configurations": {name: _placed(name, one, beside) for name, one in spec.configurations.items()},
            }
        )


def _expanded(name: str) -> str:
    """A path with the variables of the environment that it names."""
    try:
        return re.sub(r"\$\{([A-Za-z_][A-Za-z0-9_]*)\}", lambda found: os.environ[found[1]], name)
    except KeyError as error:
        problem = f"{name!r}, expected the variable {error.args[0]} of the environment to be set"
        raise ConfigError(problem, field="recordings") from None


def _placed(name: str, one: Configuration, folder: Path) -> Configuration:
    """A configuration with the command and its version as they are on this computer."""

    def here(words: tuple[str, ...]) -> tuple[str, ...]:
        return tuple(word.replace("{here}", str(folder)) for word in words)

    try:
        version = one.version
        if not isinstance(version, str):  # the first line that the program prints
            printed = run_program(words := here(version)).splitlines()
            version = next((line.strip()[:LONGEST_VERSION] for line in printed if line.strip()), "")
            if not version:
                raise InputError("printed nothing, expected a version", file=words[0])
    except InputError as error:
        raise ConfigError(str(error), field=f"configurations.{name}.version") from error
    return one.model_copy(update={"command": here(one.command), "version": version})


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


def numbers(text: str) -> list[int]:
    """The seeds of a text such as ``0-9`` or ``3,5,10-19``, in its order, each once."""
    found: dict[int, None] = {}
    for part in text.split(","):
        match = re.fullmatch(r"\s*([0-9]{1,9})\s*(?:-\s*([0-9]{1,9})\s*)?", part)
        if match is None:
            raise ValueError(f"{text!r}, expected seeds such as 0-9 or 3,5,10-19, of up to 9 digits")
        first, last = int(match[1]), int(match[2] or match[1])
        if last < first or last - first >= MAX_RUNS:
            raise ValueError(f"{text!r}, expected ranges that rise, of at most {MAX_RUNS} seeds")
        found |= dict.fromkeys(range(first, last + 1))
    return list(found)
