"""How many processors this process may use: fewer than the machine has, where it is confined to some of them."""

from __future__ import annotations

import os


def processor_count() -> int:
    """The processors that this process may run on, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
