"""TOML tables: read whole or not at all, and laid over one another key by key."""

from __future__ import annotations

import tomllib
from os import PathLike
from pathlib import Path
from typing import Any

from moteslam.errors import ConfigError

Table = dict[str, Any]


def read_toml(path: str | PathLike[str], what: str) -> Table:
    """The table of a TOML file.

    Args:
        path: of the file.
        what: was expected there, for the message: ``a TOML file``.

    Raises:
        ConfigError: it cannot be read, or is not TOML.
    """
    path = Path(path)
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ConfigError(f"{error.strerror}, expected {what}", file=path) from error
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise ConfigError(f"not TOML: {error}", file=path) from error


def toml_value(text: str) -> Any:
    """A value as TOML writes it; anything else is a string."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def merged(base: Table, over: Table) -> Table:
    """``base`` with the single values of ``over`` in place of its own, tables within tables."""
    result = dict(base)
    for key, value in over.items():
        below = result.get(key)
        result[key] = merged(below, value) if isinstance(below, dict) and isinstance(value, dict) else value
    return result
