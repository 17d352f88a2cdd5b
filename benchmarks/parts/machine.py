"""Where and when a benchmark was run, and the file that records it."""

from __future__ import annotations

import json
import os
import platform
import sys
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
    """The processor's name, where the system gives it; else its kind."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return f"{line.partition(':')[2].strip()}, {platform.machine()}"
    return platform.machine()


def resident_bytes() -> int:
    """Memory of this process that is in use now; the most it ever had, where the system gives none."""
    return _memory("VmRSS")


def most_bytes() -> int:
    """The most memory that this process has had; ``ru_maxrss`` begins with what its parent had."""
    return _memory("VmHWM")


def _memory(field: str) -> int:
    with suppress(OSError):
        lines = Path("/proc/self/status").read_text(encoding="ascii").splitlines()
        return 1024 * next(int(line.split()[1]) for line in lines if line.startswith(field))
    import resource

    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * (1 if sys.platform == "darwin" else 1024)


def save(path: Path | None, result: dict[str, Any]) -> None:
    """Write a result file, and the folders above it; nothing where none is asked for."""
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(result, indent=1) + "\n", encoding="utf-8")
