"""The keys of every run of SLAM; each method has a model of its own under this one, with its own keys alone.

Frozen, unknown keys refused. The values follow from a named preset, a file over it, and settings over both. A preset
names a method, whose defaults are its values. The resolved configuration is saved with the result.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from difflib import get_close_matches
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeVar

import tomli_w
from pydantic import Field, SerializeAsAny, field_validator, model_validator

from moteslam.errors import ConfigError
from moteslam.plugins import Plugins
from moteslam.robot.values import (
    Positive,
    Section,
    Share,
    Table,
    Whole,
    assigned,
    expect_type,
    merged,
    read_toml,
    validated,
)
from moteslam.slam.backend.protocol import BACKENDS, BackendConfig, NoBackendConfig
from moteslam.slam.filter.resampling import KldConfig
from moteslam.slam.filter.update_policy import UpdateConfig
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.mapping.config import MapConfig
from moteslam.slam.texture.floor_map import TextureConfig

if TYPE_CHECKING:
    from moteslam.slam.filter.protocol import Filter

Kind = TypeVar("Kind")


class SlamConfig(Section):
    """The keys of every method. It cannot be built itself: build a method's own, or take a preset."""

    # The filter: `tsdf` has a TSDF for every particle, `paper` one occupancy map for all; or one that another package
    # brings
    method: str
    max_range: Positive = 1000.0  # Endpoints beyond it are not used [m]
    sync: SyncConfig = SyncConfig()
    map: MapConfig = MapConfig()
    texture: TextureConfig = TextureConfig()
    backend: SerializeAsAny[BackendConfig] = NoBackendConfig()

    @model_validator(mode="before")
    @classmethod
    def _is_of_a_method(cls, values: Any) -> Any:
        if cls in (SlamConfig, ParticleFilterConfig):
            raise ValueError("no method of its own, expected the model of a method, or load_preset()")
        return values

    @field_validator("backend", mode="before")
    @classmethod
    def _of_its_kind(cls, table: Any) -> Any:
        """The table of a back end as the model that its method chooses."""
        if not isinstance(table, dict):
            return table
        name = table.get("method", cls.model_fields["backend"].default.method)
        return validated(_named(BACKENDS, name, "backend.method").config, table, above="backend")

    def to_toml(self) -> str:
        """The configuration as TOML; it reads back equal."""
        return tomli_w.dumps(self.model_dump(mode="json"))


class ParticleFilterConfig(SlamConfig):
    """The keys of every method that is a particle filter."""

    # Number of particles; the largest number where `kld` adapts it
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] = 100
    # Resample when the effective number falls under this share of the particles (section III.D.3); 0 never does, 1
    # after every update
    resample_below: Share = 0.5
    # `systematic` draws one random number, `stratified` one for each particle, `residual` copies by the integer part of
    # the expected number and draws the rest
    resampling: Literal["systematic", "stratified", "residual"] = "systematic"
    kld: KldConfig = KldConfig()
    update: UpdateConfig = UpdateConfig()


def made_on_demand(module: str, name: str) -> Callable[[Any, int], Filter]:
    """Makes the filter of that name; its module, which imports Taichi, is imported then."""

    def make(config: Any, seed: int) -> Filter:
        filter_: Filter = getattr(import_module(module), name)(config, seed)
        return filter_

    return make


@dataclass(frozen=True)
class Method:
    """A filter as it is registered; building one must not import Taichi, making its filter may."""

    # the model of its configuration, under ``SlamConfig``, whose ``method`` is the entry point's name
    config: type[SlamConfig]
    make: Callable[[Any, int], Filter]  # makes the filter for a run, of its configuration and the seed
    needs_odometry: bool = True  # it refuses recordings without odometry


METHODS: Plugins[Method] = Plugins(
    "moteslam.filters",
    Method,
    bundled={
        "tsdf": "moteslam.slam.tsdf.config:METHOD",
        "paper": "moteslam.slam.paper.config:METHOD",
        "known_map": "moteslam.slam.known_map.config:METHOD",
    },
)
"""By name; the configuration key ``method`` chooses one."""


DEFAULT_PRESET = "default"
"""The best preset that exists."""
PRESETS = {DEFAULT_PRESET: "tsdf", "paper": "paper", "localize": "known_map"}
"""The method of each preset: a TSDF for every particle, the paper's filter, and localisation in a known map."""


def preset_names() -> list[str]:
    """The names of the bundled presets, sorted."""
    return sorted(PRESETS)


def load_preset(name: str = DEFAULT_PRESET) -> SlamConfig:
    """The preset of that name.

    Raises:
        ConfigError: there is no such preset; the names are listed.
    """
    return resolve_config(name)


def resolve_config(
    preset: str = DEFAULT_PRESET, settings: Sequence[str] | Mapping[str, Any] = (), file: Path | None = None
) -> SlamConfig:
    """The configuration that follows from a preset, a file over it, and settings over both.

    Args:
        preset: name of a bundled preset.
        settings: ``key=value`` with dotted keys, ``map.cell_size=0.1``, where the value is TOML or a bare word, or a
            table: ``{"map": {"cell_size": 0.1}}``.
        file: a TOML file with any of the keys.

    Raises:
        ConfigError: an unknown preset, method or key, or a value out of bounds; what was expected is named.
    """
    expect_type(preset, str, "preset", f"one of {', '.join(preset_names())}")
    if preset not in PRESETS:
        text = f"no such preset, expected one of {', '.join(preset_names())}"
        text += f"; a method is chosen by --set method={preset}" if preset in METHODS.names() else ""
        raise ConfigError(text, field=repr(preset)[1:-1])
    given: Table = {}
    if file is not None:
        given = read_toml(file, "a TOML file")
        _resolved(PRESETS[preset], given, file=file)
    changes = dict(settings) if isinstance(settings, Mapping) else assigned(settings)
    return _resolved(PRESETS[preset], _over(given, changes), file=None)


def _resolved(method: str, given: Table, *, file: Path | None) -> SlamConfig:
    """A method's defaults, or those of the method that is given, and what is given over them."""
    model = _named(METHODS, given.get("method", method), "method", file=file).config
    base = model.model_validate({}).model_dump(mode="json")
    values = _over(base, {**given, "method": base["method"]})
    try:
        return validated(model, values, file=file)
    except ConfigError as error:  # of the back end's table, which is validated by itself
        problem = error.problem
        if problem.startswith("unknown key"):
            key = error.field or ""
            problem = f"{_nearest(key, base) or problem}; moteslam replay --print-config lists all"
            others = (preset for preset, other in PRESETS.items() if other != base["method"] and key in _keys(other))
            problem = next((f"a key of the preset {preset}, expected that preset" for preset in others), problem)
        raise ConfigError(problem, file=file, field=error.field) from error


def _nearest(key: str, known: Table) -> str:
    """The problem of a key that is unknown at the top, or in its table, but in one below that is as good as known."""
    above, _, word = key.rpartition(".")
    keys = {each: each.rpartition(".")[2] for each in _dotted(known) if each.startswith(f"{above}." * bool(above))}
    near = get_close_matches(word, keys.values(), cutoff=0.8)
    like = [each for each, last in keys.items() if last in near or last.startswith(f"{word}_")][:3]
    return f"unknown key, expected one like {', '.join(like)}" if like else ""


def _keys(method: str) -> frozenset[str]:
    return frozenset(_dotted(METHODS[method].config.model_validate({}).model_dump(mode="json")))


def _dotted(table: Table, above: str = "") -> Iterator[str]:
    for name, value in table.items():
        yield above + name
        if isinstance(value, dict):
            yield from _dotted(value, f"{above}{name}.")


def _over(values: Table, others: Table) -> Table:
    """Values with others over them; where these name another back end, the keys of the one below are left out."""
    below, above = _backend_of(values), _backend_of(others)
    if None not in (below, above) and above != below:
        values = {**values, "backend": {}}
    return merged(values, others)


def _backend_of(table: Table) -> object:
    """The back end that a table asks for, None if it asks for none by name."""
    backend = table.get("backend")
    return backend.get("method") if isinstance(backend, dict) else None


def _named(kinds: Plugins[Kind], name: object, field: str, *, file: Path | None = None) -> Kind:
    """The plug-in that a configuration names in a field."""
    if not isinstance(name, str):
        raise ConfigError(f"{name!r}, expected one of {', '.join(kinds.names())}", file=file, field=field)
    try:
        return kinds[name]
    except ConfigError as error:
        raise ConfigError(error.problem, file=file, field=field) from error
