"""The options that several commands share, told once."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

OUT = "Folder for the result; it must not exist."

Force = Annotated[bool, typer.Option("--force", help="Replace an existing --out, whole, at the end.")]
Json = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
Preset = Annotated[str | None, typer.Option(metavar="NAME", help="Named configuration; the best by default.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", metavar="KEY=VALUE", help="Change one value; may be repeated.")
]
ConfigFile = Annotated[
    Path | None, typer.Option("--config", metavar="FILE", help="TOML file over the preset, under --set.")
]
Seed = Annotated[int, typer.Option(min=0, max=2**63 - 1, help="Of all randomness; same seed, same bytes.")]
Particles = Annotated[int | None, typer.Option(min=1, help="The same as --set particles=N.")]
Threads = Annotated[int | None, typer.Option(min=1, max=1024, help="CPU threads; all cores by default.")]
Arch = Annotated[str, typer.Option(metavar="cpu|cuda", help="Where the kernels run.")]
NoFigures = Annotated[bool, typer.Option("--no-figures", help="Leave the figures out.")]
PrintConfig = Annotated[
    bool, typer.Option("--print-config", help="Print the resolved configuration as TOML and leave.")
]


def resolved_config(preset: str | None, file: Path | None, settings: list[str] | None, particles: int | None) -> Any:
    """The ``SlamConfig`` that the options come to: flag over file over preset.

    Raises:
        ConfigError: an unknown preset or key, or a value out of bounds.
    """
    from moteslam.slam.config import DEFAULT_PRESET, resolve_config

    flags = list(settings or [])
    if particles is not None:
        flags.append(f"particles={particles}")
    return resolve_config(DEFAULT_PRESET if preset is None else preset, flags, file)


def print_config(config: Any, *, as_json: bool) -> None:
    """Print a resolved configuration: as TOML that ``--config`` reads, or as JSON."""
    from moteslam.eval.cli.text import say, say_json

    if as_json:
        say_json(config.model_dump(mode="json"))
    else:
        say(config.to_toml().rstrip("\n"))
