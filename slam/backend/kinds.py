"""The back ends there are: the bundled ones, and those of other packages (entry points ``moteslam.backends``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from moteslam.plugins import Plugins
from moteslam.slam.backend.none import NoBackend, NoBackendConfig
from moteslam.slam.backend.protocol import Backend, BackendConfig


@dataclass(frozen=True)
class BackendKind:
    """A kind of back end.

    Attributes:
        config: the model of its section ``[backend]``; its ``method`` is the entry point's.
        make: makes one for a run, of its configuration.
    """

    config: type[BackendConfig]
    make: Callable[[Any], Backend]


NONE = BackendKind(NoBackendConfig, NoBackend)

BACKENDS: Plugins[BackendKind] = Plugins(
    "moteslam.backends",
    BackendKind,
    bundled={"none": "moteslam.slam.backend.kinds:NONE", "graph": "moteslam.slam.backend.graph.backend:GRAPH"},
)
"""By name; the configuration key ``backend.method`` chooses one."""
