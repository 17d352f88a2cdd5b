"""The options that several commands share, declared once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields
from functools import wraps
from inspect import Parameter, signature
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer

from moteslam.errors import ConfigError, ExistsError, OutputError

if TYPE_CHECKING:
    from moteslam.slam.config import SlamConfig

OUT = "Folder for the result; it must not exist."

Force = Annotated[bool, typer.Option("--force", help="Replace an existing --out, whole, at the end.")]
ForceFile = Annotated[bool, typer.Option("--force", help="Replace an existing file.")]
ForceOut = Annotated[bool, typer.Option("--force", help="Replace an existing --out.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Format = Annotated[
    str | None,
    typer.Option("--format", metavar="text|markdown|latex|csv|json", help="Of the table that is printed [text]."),
]
Sequence = Annotated[
    str | None,
    typer.Option("--sequence", "--session", help="Which of several sequences in a folder, or sessions of a bag."),
]
Robot = Annotated[
    str | None, typer.Option("--platform", metavar="NAME|FILE", help="Another robot: see moteslam platforms.")
]
NoiseClass = Annotated[
    str | None,
    typer.Option("--noise", metavar="datasheet|as_recorded", help="How wrong the sensors are; datasheet by default."),
]
PlatformFile = Annotated[
    Path | None,
    typer.Option(metavar="NAME|FILE", help="Another robot; a platform.toml lies over what the recording states."),
]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value; may be repeated.")
]


def refuse_existing(file: Path | None, *, force: bool) -> None:
    """Refuse a file to write that is there already.

    Raises:
        ExistsError: it is, and is not to be replaced.
        OutputError: it is there and no regular file.
    """
    if file is None:
        return
    from moteslam.robot.files import expect_file

    expect_file(file)
    if file.exists() and not force:
        raise ExistsError("exists already; name a new file", file=file)


def expect_picture(file: Path) -> None:
    """Refuse a name that is none of a picture.

    Raises:
        OutputError: it does not end in ``.png``.
    """
    if file.suffix.lower() != ".png":
        raise OutputError("expected a name that ends in .png", file=file)


def chosen_format(given: str | None, *, as_json: bool) -> str:
    """The format that ``--format`` and ``--json`` come to.

    Raises:
        ConfigError: there is none of that name, or the two differ.
    """
    from moteslam.eval.tables import FORMATS

    known = ("text", *FORMATS, "json")
    if given is not None and given not in known:
        raise ConfigError(f"{given!r}, expected one of {', '.join(known)}", field="--format")
    if as_json and given not in (None, "json"):
        raise ConfigError(f"{given!r} with --json, expected one of the two", field="--format")
    return "json" if as_json else given or "text"


@dataclass(frozen=True)
class SlamOptions:
    """How a run of SLAM is configured on the command line: each field is an option."""

    preset: Annotated[str | None, typer.Option(metavar="NAME", help="Named configuration; the best by default.")] = None
    config: Annotated[
        Path | None, typer.Option("--config", metavar="FILE", help="TOML file over the preset, under --set.")
    ] = None
    settings: Settings = None
    particles: Annotated[int | None, typer.Option(min=1, help="The same as --set particles=N.")] = None
    seed: Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Of all randomness; same seed, same bytes.")] = 0
    threads: Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads; all cores by default.")] = None
    arch: Annotated[str, typer.Option(metavar="cpu|cuda", help="Where the kernels run.")] = "cpu"
    no_figures: Annotated[bool, typer.Option("--no-figures", help="Leave the figures out.")] = False
    force: Force = False
    print_config: Annotated[
        bool, typer.Option("--print-config", help="Print the resolved configuration as TOML and leave.")
    ] = False
    as_json: Json = False

    def resolved(self) -> SlamConfig:
        """The configuration that the options come to: flag over file over preset.

        Raises:
            ConfigError: an unknown preset or key, or a value out of bounds; the option is named.
        """
        from moteslam.slam.settings import DEFAULT_PRESET, resolve_config

        flags = list(self.settings or [])
        if self.particles is not None:
            flags.append(f"particles={self.particles}")
        try:
            resolve_config(preset := self.preset if self.preset is not None else DEFAULT_PRESET)
        except ConfigError as error:
            raise ConfigError(error.problem, field=f"--preset {error.field}") from error
        try:
            return resolve_config(preset, flags, self.config)
        except ConfigError as error:
            if error.file is not None or not error.field:
                raise
            raise ConfigError(error.problem, field=self._flag(error.field)) from error

    def _flag(self, key: str) -> str:
        """The option that set a key."""
        if key == "settings":
            return "--set"
        return "--particles" if key == "particles" and self.particles is not None else f"--set {key}"


def with_options(**groups: type[Any]) -> Callable[[Callable[..., None]], Callable[..., None]]:
    """Give a command the options of some groups after its own; it gets each group as one argument.

    Args:
        groups: the name of the argument, and a dataclass whose fields are options: ``run=SlamOptions``.
    """

    def extended(command: Callable[..., None]) -> Callable[..., None]:
        hints = get_type_hints(command, include_extras=True)
        own = [
            parameter.replace(annotation=hints[name], kind=Parameter.KEYWORD_ONLY)
            for name, parameter in signature(command).parameters.items()
            if name not in groups
        ]
        shared = {name: _parameters(group) for name, group in groups.items()}

        @wraps(command)
        def whole(**given: Any) -> None:
            for name, parameters in shared.items():
                given[name] = groups[name](**{parameter.name: given.pop(parameter.name) for parameter in parameters})
            command(**given)

        listed = signature(command).replace(parameters=[*own, *chain.from_iterable(shared.values())])
        whole.__signature__ = listed  # type: ignore[attr-defined]  # Typer reads it
        whole.__annotations__ = {parameter.name: parameter.annotation for parameter in listed.parameters.values()}
        return whole

    return extended


def _parameters(group: type[Any]) -> list[Parameter]:
    types = get_type_hints(group, include_extras=True)
    return [
        Parameter(field.name, Parameter.KEYWORD_ONLY, default=field.default, annotation=types[field.name])
        for field in fields(group)
    ]


def print_config(config: Any, *, as_json: bool) -> None:
    """Print a resolved configuration: as TOML that ``--config`` reads, or as JSON."""
    from moteslam.eval.cli.text import say, say_json

    if as_json:
        say_json(config.model_dump(mode="json"))
    else:
        say(config.to_toml().rstrip("\n"))
