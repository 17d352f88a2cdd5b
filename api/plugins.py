"""Filters, back ends, formats and metrics by name, in one table each: the bundled ones and those of other packages.

Other packages bring theirs by entry points, in the groups ``moteslam.filters``, ``moteslam.backends``,
``moteslam.formats`` and ``moteslam.metrics``; the bundled ones are written down as entry points are. Nothing is
imported before it is asked for.
"""

import warnings
from collections.abc import Container, Iterator, Mapping
from functools import cache, cached_property
from hashlib import sha256
from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any, Generic, TypeVar

from moteslam.errors import ConfigError, MoteslamWarning

T = TypeVar("T")


class PluginWarning(MoteslamWarning):
    """A plug-in that is left out; what is wrong with it, in one line."""


class Plugins(Generic[T]):
    """The plug-ins of one group, by name. No other package replaces a bundled one.

    Args:
        group: of the entry points.
        kind: what each of them must be an instance of.
        bundled: those of this package by name: themselves, or their place, ``module:attribute``.
    """

    def __init__(self, group: str, kind: type[T], *, bundled: Mapping[str, T | str]) -> None:
        self.group, self._kind = group, kind
        self._bundled = {
            name: EntryPoint(name, value if isinstance(value, str) else "", group) for name, value in bundled.items()
        }
        self._loaded: dict[str, T] = {name: value for name, value in bundled.items() if not isinstance(value, str)}
        self._problems: dict[str, str] = {}

    def names(self) -> list[str]:
        return [*self._bundled, *self._others]

    def is_bundled(self, name: str) -> bool:
        return name in self._bundled

    def warn(self, name: str, problem: str) -> None:
        """Warn that a plug-in of another package failed while it was used."""
        _warn(self._others[name], problem)

    def __getitem__(self, name: str) -> T:
        entry = self._bundled.get(name) or self._others.get(name)
        if entry is None:
            known = ", ".join(each for each, _ in self.items())
            raise ConfigError(
                f"{name!r}, expected one of {known}; your own package must be installed: pip install -e ."
            )
        self._load(entry)
        if name in self._problems:
            raise ConfigError(f"{name!r} of package {_package(entry)} cannot be loaded: {self._problems[name]}")
        return self._loaded[name]

    def items(self) -> Iterator[tuple[str, T]]:
        """All plug-ins that can be loaded, by name; each other one is one ``PluginWarning``."""
        for name, entry in {**self._bundled, **self._others}.items():
            seen = name in self._problems
            self._load(entry)
            if name in self._loaded:
                yield name, self._loaded[name]
            elif not seen:
                _warn(entry, self._problems[name])

    @cached_property
    def _others(self) -> dict[str, EntryPoint]:
        """Those of other packages by name, sorted; of two with one name the first package's."""
        others: dict[str, EntryPoint] = {}
        for entry in sorted(_installed().select(group=self.group), key=lambda entry: (entry.name, _package(entry))):
            if entry.name in self._bundled:
                _warn(entry, "its name is taken")
            elif _package(others.setdefault(entry.name, entry)) != _package(entry):
                _warn(entry, f"its name is taken by package {_package(others[entry.name])}")
        return others

    def _load(self, entry: EntryPoint) -> None:
        """Once: into ``_loaded``, or why it cannot be used into ``_problems``."""
        if entry.name in self._loaded or entry.name in self._problems:
            return
        try:
            found = entry.load()
        except Exception as error:
            if entry.name in self._bundled:
                raise
            self._problems[entry.name] = " ".join(f"{type(error).__name__}: {error}".split())
            return
        if isinstance(found, self._kind):
            self._loaded[entry.name] = found
        else:
            self._problems[entry.name] = f"{entry.value} is a {type(found).__name__}, expected a {self._kind.__name__}"


_installed: Any = cache(entry_points)  # looked up once: that reads a file of each installed package


def _entries() -> list[EntryPoint]:
    groups = (f"moteslam.{group}" for group in ("filters", "backends", "formats", "metrics"))
    return [entry for group in groups for entry in _installed().select(group=group)]


def code_of(names: Container[str]) -> dict[str, str]:
    """SHA-256 of the Python files of the packages of plug-ins with these names, by name."""
    found = {}
    for entry in _entries():
        spec = find_spec(entry.module.partition(".")[0]) if entry.name in names else None
        if spec is not None:
            folders = spec.submodule_search_locations or ()
            files = sorted(file for folder in folders for file in Path(folder).rglob("*.py"))
            code = (file.read_bytes() for file in files or [Path(spec.origin or "")])
            found[entry.name] = sha256(b"".join(code)).hexdigest()
    return found


def blamed(error: BaseException) -> str | None:
    """The plug-in of another package in whose code an error was raised, in words; None if in none's."""
    frames, found, entries = error.__traceback__, None, _entries()
    while frames is not None:
        module = str(frames.tb_frame.f_globals.get("__name__"))
        of = [entry for entry in entries if f"{module}.".startswith(f"{entry.module.split('.')[0]}.")]
        found = next((entry for entry in of if entry.module == module), of[0] if of else found)
        frames = frames.tb_next
    return None if found is None else _named(found)


def _named(entry: EntryPoint) -> str:
    return f"plug-in {entry.name!r} of package {_package(entry)} ({entry.group})"


def _package(entry: EntryPoint) -> str:
    return entry.dist.name if entry.dist is not None else "unknown"


def _warn(entry: EntryPoint, problem: str) -> None:
    warnings.warn(f"{_named(entry)} is left out: {problem}", PluginWarning, stacklevel=4)
