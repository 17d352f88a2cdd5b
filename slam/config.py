"""The keys of every run of SLAM; each method has a model of its own under this one, with its own keys alone.

Frozen, unknown keys refused. Where the values come from: ``settings``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Annotated, Any, Literal

import tomli_w
from pydantic import Field, SerializeAsAny, field_validator, model_validator

from moteslam.errors import ConfigError
from moteslam.plugins import Plugins
from moteslam.robot.values import Positive, Section, Share, Whole, validated
from moteslam.slam.backend.protocol import BACKENDS, BackendConfig, NoBackendConfig
from moteslam.slam.filter.resampling import KldConfig
from moteslam.slam.filter.update_policy import UpdateConfig
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.mapping.config import MapConfig
from moteslam.slam.texture.config import TextureConfig

if TYPE_CHECKING:
    from moteslam.slam.filter.protocol import Filter


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
        if not isinstance(name, str):
            raise ConfigError(f"{name!r}, expected one of {', '.join(BACKENDS.names())}", field="backend.method")
        try:
            model = BACKENDS[name].config
        except ConfigError as error:
            raise ConfigError(error.problem, field="backend.method") from error
        return validated(model, table, above="backend")

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
