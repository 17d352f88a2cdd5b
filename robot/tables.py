"""TOML tables: read, and merged key by key."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from os import PathLike
from typing import Any

from moteslam.errors import ConfigError
from moteslam.robot.reading import read_text

Table = dict[str, Any]

MAX_BYTES = 4_000_000
"""No configuration, platform or scenario is larger."""


def read_toml(path: str | PathLike[str], what: str) -> Table:
    """The table of a TOML file.

    Args:
        path: of the file.
        what: was expected there, for the message: ``a TOML file``.

    Raises:
        ConfigError: it cannot be read, is larger than ``MAX_BYTES``, or is not TOML.
    """
    text = read_text(path, what, limit=MAX_BYTES, error=ConfigError)
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise ConfigError(f"not TOML: {error}", file=path) from error
    except (ValueError, RecursionError) as error:
        problem = "tables nested too deep" if isinstance(error, RecursionError) else "a number of too many digits"
        raise ConfigError(f"not TOML: {problem}", file=path) from error


def toml_value(text: str) -> Any:
    """A value as TOML writes it; anything else is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except (ValueError, RecursionError):  # no value, too many digits, or nested too deep
        return text


def merged(base: Table, over: Table) -> Table:
    """``base`` with the single values of ``over`` in place of its own, tables within tables."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return result


def leaves(table: Table, prefix: str = "") -> Iterator[str]:
    """The dotted keys of a table's values."""
    for key, value in table.items():
        if isinstance(value, dict):
            yield from leaves(value, f"{prefix}{key}.")
        else:
            yield f"{prefix}{key}"


def assigned(settings: Sequence[str]) -> Table:
    """The table of settings ``key=value`` with dotted keys; a value is TOML, a bare word a string, the last counts.

    Raises:
        ConfigError: no list of ``key=value``; the field is ``settings``.
    """
    if isinstance(settings, str):
        raise ConfigError(f"{settings!r}, expected a list of key=value", field="settings")
    table: Table = {}
    for setting in settings:
        key, equals, value = setting.partition("=")
        if not equals or not key.strip():
            raise ConfigError(f"expected key=value, found {setting!r}", field="settings")
        tree: Any = toml_value(value.strip())
        for part in reversed(key.strip().split(".")):
            tree = {part: tree}
        table = merged(table, tree)
    return table
