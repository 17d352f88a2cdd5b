"""The back ends there are: the bundled ones, and those of other packages (entry points ``moteslam.backends``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal

from moteslam.plugins import Plugins
from moteslam.robot.se2 import Array
from moteslam.robot.values import Issue
from moteslam.slam.backend.ledger import LoopCandidate
from moteslam.slam.backend.protocol import Backend, BackendConfig, KeyScan


@dataclass(frozen=True)
class BackendKind:
    """A kind of back end."""

    config: type[BackendConfig]  # the model of its section ``[backend]``; its `method` is the entry point's
    make: Callable[[Any], Backend]  # makes one for a run, of its configuration


class NoBackendConfig(BackendConfig):
    """No back end: what the filter finds is final."""

    # The back end behind the filter: `none`, `graph`, or one that another package brings
    method: Literal["none"] = "none"


class NoBackend:
    """Corrects nothing."""

    loops: tuple[LoopCandidate, ...] = ()
    measured: None = None
    issues: tuple[Issue, ...] = ()

    def __init__(self, config: NoBackendConfig) -> None:
        del config

    def add(self, key: KeyScan) -> None:
        """See ``Backend``."""

    def finish(self, path: Array) -> None:
        """See ``Backend``."""

    relocated = finish


NONE = BackendKind(NoBackendConfig, NoBackend)

BACKENDS: Plugins[BackendKind] = Plugins(
    "moteslam.backends",
    BackendKind,
    bundled={"none": "moteslam.slam.backend.kinds:NONE", "graph": "moteslam.slam.backend.graph.backend:GRAPH"},
)
"""By name; the configuration key ``backend.method`` chooses one."""
