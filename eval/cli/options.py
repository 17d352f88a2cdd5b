"""The options that several commands share, declared once."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, fields, replace
from functools import wraps
from inspect import Parameter, Signature, signature
from math import inf
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from moteslam.errors import ConfigError, ExistsError, InputError, MoteslamError, OutputError
from moteslam.eval.cli.text import answer

if TYPE_CHECKING:
    from moteslam.robot.recording import Recording
    from moteslam.robot.values import Issue
    from moteslam.slam.config import SlamConfig


def opt(help: str, meta: str | None = None, *flags: str, **more: Any) -> Any:  # noqa: A002 - as Typer calls it
    """An option: its help, what its value is called, its names where they are not the parameter's."""
    return typer.Option(*flags, metavar=meta, help=help, **more)


def arg(help: str, meta: str, **more: Any) -> Any:  # noqa: A002
    """An argument: its help, what it is called."""
    return typer.Argument(metavar=meta, help=help, **more)


def flag(name: str, help: str) -> Any:  # noqa: A002
    """An option that is on or off, without the ``--no-`` that Typer would add."""
    return typer.Option(name, help=help)


OUT = "Folder for the result; it must not exist."
TOPIC_STREAMS = ("lidar", "odometry", "imu", "encoders")  # What a topic of a bag can be read as
Force = Annotated[bool, flag("--force", "Replace an existing --out, whole, at the end.")]
ForceFile = Annotated[bool, flag("--force", "Replace an existing file.")]
Json = Annotated[bool, flag("--json", "Print the result as JSON.")]
Format = Annotated[
    Literal["text", "markdown", "latex", "csv"],
    opt("Format of the printed table.", "markdown|latex|csv", "--format"),
]
FIGURES = (".png", ".pdf", ".svg")  # Endings of the files of figures
Metrics = Annotated[
    list[str] | None, opt("Metric to show [those that the sweeps name, or the usual]; repeatable.", "NAME", "--metric")
]
Baseline = Annotated[str | None, opt("Compare with this configuration or robot [the first].", "NAME", "--baseline")]
By = Annotated[
    str | None, opt("What to compare: platform, a varied key, ... [configuration, if several].", "COLUMN", "--by")
]
ScenarioName = Annotated[str, arg("Bundled name, random-corridors, or a .toml file.", "SCENARIO")]
Seed = Annotated[int | None, opt("Seed of all randomness; the scenario's own by default.", min=0, max=2**63 - 1)]
Sequence = Annotated[str | None, opt("Which sequence of a folder, or session of a bag.", None, "--sequence")]
Robot = Annotated[str | None, opt("Another robot: see moteslam platforms.", "NAME|FILE", "--platform")]
NoiseClass = Annotated[
    Literal["datasheet", "as_recorded"] | None,
    opt("How wrong the sensors are; datasheet by default.", "datasheet|as_recorded", "--noise"),
]
PlatformFile = Annotated[Path | None, opt("Another robot; its keys override what the recording states.", "NAME|FILE")]
Preset = Annotated[str | None, opt("Named configuration, such as paper; the best by default.", "NAME")]
Settings = Annotated[list[str] | None, opt("Override one value; may be repeated.", "KEY=VALUE", "--set")]


@contextmanager
def named(option: str | None = None, /, **by_field: str) -> Iterator[None]:
    """Errors of the block that name no file name an option: that of their field, else the one given for all."""
    try:
        yield
    except MoteslamError as error:
        flag = by_field.get(error.field or "", option)
        if flag is None or error.file is not None:
            raise
        raise type(error)(error.problem, field=flag.replace("{}", str(error.field))) from error


@contextmanager
def new_file(file: Path | None, *endings: str, force: bool) -> Iterator[None]:
    """Refuse a file to write that exists, is no regular file, or whose ending is not one of these.

    Folders above it are made; an error in the block leaves none of them.
    """
    from moteslam.files import expect_file, folder_for

    if file is None:
        yield
        return
    if endings and file.suffix.lower() not in endings:
        raise OutputError(f"expected a name that ends in {' or '.join(endings)}", file=file)
    expect_file(file)
    if file.exists() and not force:
        raise ExistsError("exists already; name a new file", file=file)
    with folder_for(file):
        yield


@dataclass(frozen=True)
class SlamOptions:
    """How a run of SLAM is configured on the command line: each field is an option."""

    preset: Preset = None
    config: Annotated[Path | None, opt("TOML file that overrides the preset.", "FILE", "--config")] = None
    settings: Settings = None
    seed: Annotated[int, opt("Seed of all randomness: same seed, same bytes.", min=0, max=2**63 - 1)] = 0
    threads: Annotated[int | None, opt("CPU threads; all cores by default.", min=1, max=1024)] = None
    arch: Annotated[str, opt("Where the kernels run.", "cpu|cuda")] = "cpu"
    mcap: Annotated[bool, flag("--mcap", "Also write result.mcap for Foxglove or Rerun: map, paths, loops, scans.")] = (
        False
    )
    no_figures: Annotated[bool, flag("--no-figures", "Leave the figures out.")] = False
    force: Force = False
    print_config: Annotated[bool, flag("--print-config", "Print the resolved configuration as TOML and exit.")] = False
    as_json: Json = False

    def resolved(self, preset: str | None = None, given: Iterable[str] = ()) -> SlamConfig:
        """The configuration: flag over file over preset. With ``--print-config`` it is printed and the command ends.

        A command has a preset of its own where none is chosen, and settings that other options than ``--set`` stand
        for.
        """
        from moteslam.slam.config import DEFAULT_PRESET, resolve_config

        preset = self.preset or preset or DEFAULT_PRESET
        with named("--set {}", **{"settings": "--set", repr(preset)[1:-1]: "--preset {}"}):
            config = resolve_config(preset, [*(self.settings or []), *given], self.config)
        if self.print_config:
            answer(config.model_dump(mode="json"), [config.to_toml().rstrip("\n")], as_json=self.as_json)
            raise typer.Exit
        return config


@dataclass(frozen=True)
class RecordingOptions:
    """Which recording, and which part of it: each field is an option."""

    sequence: Sequence = None
    platform: PlatformFile = None
    topics: Annotated[
        list[str] | None, opt("Topic of a bag to read a stream from; may be repeated.", "STREAM=TOPIC")
    ] = None
    streams: Annotated[str | None, opt("Keep only these: lidar,encoders,odometry,imu,rgbd.", "NAMES")] = None
    start: Annotated[float, opt("Begin S seconds after the first stamp.", "S")] = 0.0
    end: Annotated[float | None, opt("End S seconds after the first stamp.", "S")] = None
    every: Annotated[int, opt("Keep every N-th scan.", "N")] = 1

    def open(self, path: Path) -> Recording:
        """The part of the recording at a path that the options ask for."""
        from moteslam.robot.formats import Cut, cut, open_recording

        if (path / "run.json").is_file() and (path / "metrics.json").is_file():
            about = json.loads((path / "run.json").read_text(encoding="utf-8"))
            of = about.get("path") or f"none: {about.get('scenario') or about.get('recording')} was simulated"
            raise InputError(f"is the result folder of a run, expected a recording; that of the run is {of}", file=path)
        streams = tuple(name.strip() for name in self.streams.split(",")) if self.streams is not None else ()
        with named(start="--start", end="--end", every="--every", streams="--streams"):
            part = Cut(self.start, inf if self.end is None else self.end, self.every, streams)
        which: dict[str, Any] = {"sequence": self.sequence, "platform": self.platform, "streams": streams}
        return cut(open_recording(path, topics=self._named(), **which), part)

    def _named(self) -> dict[str, tuple[str, ...]]:
        topics: dict[str, tuple[str, ...]] = {}
        for words in self.topics or ():
            stream, _, text = words.partition("=")
            names = tuple(name.strip() for name in text.split(",") if name.strip())
            if stream not in TOPIC_STREAMS or not names:
                expected = f"STREAM=TOPIC with a stream of {', '.join(TOPIC_STREAMS)}"
                raise ConfigError(f"{words!r}, expected {expected}", field="--topics")
            if stream in topics:
                raise ConfigError(f"{stream} twice, expected lidars to merge as lidar=/front,/back", field="--topics")
            topics[stream] = names
        return topics

    def about_each_lidar(self, path: Path) -> Iterator[Issue]:
        """Of several lidars that are read as one, what is not as stated of each: the odometry tells them apart."""
        from moteslam.slam.calibration.calibrate import FEW_PAIRS
        from moteslam.slam.calibration.checked import checked

        others = [words for words in self.topics or () if words.partition("=")[0] != "lidar"]
        names = self._named().get("lidar", ())
        for name in names if len(names) > 1 else ():
            about = checked(replace(self, topics=[*others, f"lidar={name}"]).open(path), FEW_PAIRS)[1]
            for one in () if about is None else about.moves:
                if one.message.startswith("lidar: ") or one.code == "mirrored":
                    text = one.message.replace("[lidar]", f'[lidars."{name}"]')
                    yield replace(one, message=f"{name}: {text.removeprefix('lidar: ')}")

    @property
    def given(self) -> dict[str, object]:
        return {field.name: value for field in fields(self) if (value := getattr(self, field.name)) != field.default}


def with_options(**groups: type[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of dataclasses after its own; it gets each as one argument: ``run=SlamOptions``."""

    def extended(command: Callable[..., None]) -> Callable[..., None]:
        @wraps(command)
        def whole(**given: Any) -> None:
            for name, group in groups.items():
                given[name] = group(**{field.name: given.pop(field.name) for field in fields(group)})
            command(**given)

        given_by: tuple[Callable[..., Any], ...] = (command, *groups.values())
        found = (one for of in given_by for one in signature(of, eval_str=True).parameters.values())
        listed = [one.replace(kind=Parameter.KEYWORD_ONLY) for one in found if one.name not in groups]
        whole.__signature__ = Signature(listed)  # type: ignore[attr-defined]  # Typer reads it
        whole.__annotations__ = {one.name: one.annotation for one in listed}
        return whole

    return extended
