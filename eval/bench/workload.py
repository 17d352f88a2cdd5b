"""Which tasks there are. Results of different versions of the workload are not compared."""

from __future__ import annotations

from moteslam.errors import ConfigError
from moteslam.eval.bench.contest import Task
from moteslam.eval.bench.tasks import (
    grid,
    integration,
    machine,
    matching,
    raycasting,
    registration,
    runs,
    search,
    thinning,
)

WORKLOAD = 1
"""Raised whenever a task does other work than before, or its C loop does it in another way."""

TASKS: dict[str, Task] = {
    "arithmetic": machine.ARITHMETIC,
    "memory": machine.MEMORY,
    "thinning": thinning.TASK,
    "registration": registration.TASK,
    "integration": integration.TASK,
    "search": search.TASK,
    "matching": matching.TASK,
    "raycasting": raycasting.TASK,
    "grid": grid.TASK,
    "run-1": runs.RUN_1,
    "run-30": runs.RUN_30,
    "simulation": runs.SIMULATION,
}
"""By name, in the order in which they are measured and shown."""
MACHINE = ("arithmetic", "memory")
"""What the machine gives: always measured, since the others are seen in relation to it."""


def chosen(names: list[str]) -> list[str]:
    """The tasks of these names, and those of the machine; all of them where none is named.

    Raises:
        ConfigError: there is none of a name.
    """
    for name in names:
        if name not in TASKS:
            raise ConfigError(f"{name!r}, expected one of {', '.join(TASKS)}", field="tasks")
    return [name for name in TASKS if not names or name in names or name in MACHINE]
