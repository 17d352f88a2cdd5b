"""Where and when a benchmark was run."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from datetime import date
from importlib.metadata import version
from pathlib import Path
from typing import Any


def stamp() -> dict[str, Any]:
    """Date, hardware, how busy it was, and versions, as they go into a result file."""
    return {
        "date": date.today().isoformat(),
        "hardware": f"{processor()}, {os.cpu_count()} cores",
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
        "versions": {name: version(name) for name in ("moteslam", "taichi", "numpy", "pymunk")},
    }


def processor() -> str:
    """The processor's name, where the system tells it; else its kind."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()}, {platform.machine()}"
    return platform.machine()
