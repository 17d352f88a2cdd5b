"""The methods there are: the bundled filters, and those of other packages (entry points ``moteslam.filters``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from moteslam.plugins import Plugins
from moteslam.slam.config import SlamConfig

if TYPE_CHECKING:
    from moteslam.slam.filter.protocol import Filter


@dataclass(frozen=True)
class Method:
    """A filter as it is registered; building one must not import Taichi, making its filter may.

    Attributes:
        config: the model of its configuration, under ``SlamConfig``, whose ``method`` is the entry point's name.
        make: makes the filter for a run, of its configuration and the seed.
        needs_odometry: it refuses recordings without odometry.
    """

    config: type[SlamConfig]
    make: Callable[[Any, int], Filter]
    needs_odometry: bool = True


METHODS: Plugins[Method] = Plugins(
    "moteslam.filters",
    Method,
    bundled={
        "tsdf": "moteslam.slam.tsdf.method:METHOD",
        "paper": "moteslam.slam.paper.method:METHOD",
    },
)
"""By name; the configuration key ``method`` chooses one."""
