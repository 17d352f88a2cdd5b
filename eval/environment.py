"""What results depend on beside their input: versions and hardware."""

from __future__ import annotations

import os
import platform
import sys
from importlib.metadata import version
from pathlib import Path
from typing import Any

from moteslam.robot.values import processor_count

PACKAGES = ("moteslam", "taichi", "numpy")
"""Whose versions are recorded."""


def environment() -> dict[str, dict[str, str]]:
    """Versions and hardware of this computer, as text by name."""
    found = {
        "versions": {"python": platform.python_version(), **{name: version(name) for name in PACKAGES}},
        "hardware": hardware(),
    }
    return {title: {name: str(value) for name, value in facts.items()} for title, facts in found.items()}


def hardware() -> dict[str, Any]:
    """What this runs on: processor, cores that may be used, memory [GiB], system."""
    return {
        "cpu": _processor(),
        "cores": processor_count(),
        "memory_gib": _memory(),
        "system": f"{platform.system()} {platform.release()} {platform.machine()}",
    }


def _processor() -> str:
    try:
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()


def _memory() -> float | None:
    if sys.platform == "win32":
        return None
    return round(os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30, 1)
