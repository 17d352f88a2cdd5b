"""The configuration that follows from a named preset, a file over it, and settings over both.

The resolved configuration is saved with the result.
"""

from __future__ import annotations

import tomllib
from importlib import resources
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from moteslam.errors import ConfigError
from moteslam.robot.wording import first_complaint, known_keys
from moteslam.slam.config import SlamConfig

DEFAULT_PRESET = "default"
"""The best preset that exists."""


def preset_names() -> list[str]:
    """The names of the bundled presets, sorted."""
    folder = resources.files("moteslam.slam.presets")
    return sorted(entry.name[:-5] for entry in folder.iterdir() if entry.name.endswith(".toml"))


def load_preset(name: str = DEFAULT_PRESET) -> SlamConfig:
    """The preset of that name.

    Raises:
        ConfigError: there is no such preset; the names are listed.
    """
    return resolve_config(name)


def resolve_config(
    preset: str = DEFAULT_PRESET, settings: list[str] | tuple[str, ...] = (), file: Path | None = None
) -> SlamConfig:
    """The configuration that follows from a preset, a file over it, and settings over both.

    Args:
        preset: name of a bundled preset.
        settings: ``key=value`` with dotted keys, ``map.cell_size=0.1``; the value is TOML, a bare word a string.
        file: a TOML file with any of the keys.

    Raises:
        ConfigError: an unknown preset, key, or a value out of bounds; what was expected is named.
    """
    if preset not in preset_names():
        raise ConfigError(f"no such preset, expected one of {', '.join(preset_names())}", field=repr(preset)[1:-1])
    text = resources.files("moteslam.slam.presets").joinpath(f"{preset}.toml").read_text(encoding="utf-8")
    values = tomllib.loads(text)
    if file is not None:
        _merge(values, _read_toml(file))
        _validate(values, file)
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"expected key=value, found {setting!r}", field="--set")
        tree: Any = _toml_value(value.strip())
        for part in reversed(key.strip().split(".")):
            tree = {part: tree}
        _merge(values, tree)
    return _validate(values, None)


def _validate(values: dict[str, Any], file: Path | None) -> SlamConfig:
    try:
        return SlamConfig.model_validate(values)
    except ValidationError as error:
        field, problem = first_complaint(
            error, "configuration", lambda place: f"expected one of {', '.join(known_keys(SlamConfig, place))}"
        )
        raise ConfigError(problem, file=file, field=field) from error


def _read_toml(file: Path) -> dict[str, Any]:
    try:
        return tomllib.loads(file.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{error.strerror}, expected a TOML file", file=file) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"not TOML: {error}", file=file) from error


def _toml_value(text: str) -> Any:
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _merge(under: dict[str, Any], over: dict[str, Any]) -> None:
    for key, value in over.items():
        if isinstance(value, dict) and isinstance(under.get(key), dict):
            _merge(under[key], value)
        else:
            under[key] = value
