"""Robots in TOML: the bundled ones, which lie beside this, and those of files."""

from __future__ import annotations

import tomllib
import types
from collections.abc import Iterator
from functools import cache
from os import PathLike
from pathlib import Path
from typing import Any, get_args

import tomli_w
from pydantic import BaseModel, ValidationError

from moteslam.errors import ConfigError
from moteslam.robot.files import write_atomically
from moteslam.robot.platform import Platform
from moteslam.robot.specs import LidarSpec
from moteslam.robot.tables import Table, merged, read_toml
from moteslam.robot.wording import Place, expect_path, first_complaint, known_keys

FOLDER = Path(__file__).parent

BASE = "base"
"""The key of a file that names the bundled robot whose values it changes."""

_MAY_BE_LEFT_OUT = frozenset({"name", "description", "top_speed", "top_turn_rate", "no_return", "noise", "as_recorded"})
"""By a whole robot: words, limits and codes that not every one has, errors that are not there unless they are given."""


def bundled_platforms() -> dict[str, str]:
    """The names of the robots that come with the package, each with a sentence on what it is."""
    return {name: bundled_platform(name).description for name in _names()}


@cache
def bundled_platform(name: str) -> Platform:
    """The bundled robot of that name.

    Raises:
        ConfigError: there is none; the names are listed.
    """
    return _platform(_bundled_table(name), file=None)


def load_platform(name_or_path: str | PathLike[str]) -> Platform:
    """A whole robot, to be simulated: a bundled one by its name, or that of a TOML file.

    A file has every key but those of ``noise`` and ``as_recorded``, or names the bundled robot whose values it changes
    with ``base``.

    Raises:
        ConfigError: no such robot, not readable, not TOML, an unknown key, a value out of bounds, or keys that are
            missing; they are named.
    """
    expect_path(name_or_path, "platform", "a robot's .toml file, or a name")
    text, path = str(name_or_path), Path(name_or_path)
    if path.suffix != ".toml" and path.name == text:
        return bundled_platform(text)
    return whole_platform({"name": path.stem, **read_toml(path, "a platform.toml")}, file=path)


def whole_platform(table: Table, *, file: str | PathLike[str] | None = None) -> Platform:
    """A robot of a table that leaves nothing out, or names its ``base``; ``file`` is named in errors.

    Raises:
        ConfigError: as ``load_platform``.
    """
    table = _over_its_base(table, file)
    platform = _platform(table, file=file, whole=True)
    _expect_whole(table, file)
    return platform


def read_platform(path: str | PathLike[str], *, base: Platform | None = None) -> Platform:
    """Read a ``platform.toml``.

    Args:
        path: the file; with a key ``base`` it changes the bundled robot of that name.
        base: the robot that it overrides, key by key; a robot of which nothing is known by default.

    Raises:
        ConfigError: not readable, not TOML, an unknown key, a value out of bounds, or a table that is begun and
            misses keys that the robot below has not; file and keys are named.
    """
    return platform_of(read_toml(Path(path), "a platform.toml"), file=path, base=base)


def platform_of(table: Table, *, file: str | PathLike[str], base: Platform | None = None) -> Platform:
    """The robot of the table in a ``platform.toml``; arguments and errors as of ``read_platform``."""
    table = _over_its_base(table, file)
    return _platform(table if base is None else merged(base.model_dump(), table), file=file)


def write_platform(path: str | PathLike[str], platform: Platform) -> None:
    """Write a platform as TOML with every key; it reads back equal, bit for bit, whatever it overrides."""
    write_atomically(path, tomli_w.dumps(platform_table(platform)))


def platform_table(platform: Platform) -> Table:
    """Every key of a platform, ``False`` for what it has not: TOML has no other word for it."""
    return _without_none(platform.model_dump())


def _without_none(table: Table) -> Table:
    return {
        key: _without_none(value) if isinstance(value, dict) else False if value is None else value
        for key, value in table.items()
    }


def _names() -> list[str]:
    return sorted(path.stem for path in FOLDER.glob("*.toml"))


def _quoted() -> str:
    return ", ".join(f'"{name}"' for name in _names())


def _bundled_table(name: str) -> Table:
    if name not in _names():
        raise ConfigError(
            f"no robot of this name, expected one of {', '.join(_names())}, or a .toml file", field=repr(name)[1:-1]
        )
    return {"name": name, **tomllib.loads((FOLDER / f"{name}.toml").read_text(encoding="utf-8"))}


def _over_its_base(table: Table, file: str | PathLike[str] | None) -> Table:
    """The table over the bundled robot that it names, if it names one."""
    if BASE not in table:
        return table
    name, changes = table[BASE], {key: value for key, value in table.items() if key != BASE}
    if name not in _names():
        raise ConfigError(f"{name!r}, expected one of {', '.join(_names())}", file=file, field=BASE)
    return merged(platform_table(bundled_platform(name)), changes)


def _expect_whole(table: Table, file: str | PathLike[str] | None) -> None:
    if missing := ", ".join(_missing(table, Platform)):
        raise ConfigError(f"{missing} missing, expected a whole robot, or base = one of {_quoted()}", file=file)


def _platform(table: Table, *, file: str | PathLike[str] | None, whole: bool = False) -> Platform:
    try:
        return Platform.model_validate(table)
    except ValidationError as error:
        field, problem = first_complaint(error, "platform.toml", _expected)
        missing = [".".join(map(str, entry["loc"])) for entry in error.errors() if entry["type"] == "missing"]
        if missing and field == missing[0]:
            if whole:
                _expect_whole(table, file)
            field = field.rpartition(".")[0]
            keys = ", ".join(key.rpartition(".")[2] for key in missing if key.rpartition(".")[0] == field)
            problem = f"{keys} missing, expected a complete [{field}] where nothing else is known of it"
        raise ConfigError(problem, file=file, field=field) from error


def _expected(place: Place) -> str:
    return f"expected one of {', '.join([*(() if place else (BASE,)), *known_keys(Platform, place)])}"


def _missing(table: Table, model: type[BaseModel], above: str = "") -> Iterator[str]:
    """The dotted keys that a table of a whole robot lacks; a table that is lacking is named alone."""
    for key, field in model.model_fields.items():
        if key in _MAY_BE_LEFT_OUT:
            continue
        if key not in table:
            if field.is_required() or model in (Platform, LidarSpec):
                yield f"{above}{key}"
            continue
        below = _model(field.annotation)
        if below is not None and isinstance(table[key], dict):
            yield from _missing(table[key], below, f"{above}{key}.")


def _model(annotation: Any) -> type[BaseModel] | None:
    """The model of a key that is a table."""
    kinds = get_args(annotation) if isinstance(annotation, types.UnionType) else (annotation,)
    return next((kind for kind in kinds if isinstance(kind, type) and issubclass(kind, BaseModel)), None)


UCSD = bundled_platform("ucsd")
"""The robot of the UCSD sequences, its origin midway between the axles."""

CARMEN = Platform(name="carmen")
"""A robot of which a CARMEN log states nothing else: odometry poses and a lidar at its centre."""
