"""How busy the computer is with other things, before something is measured on it."""

from __future__ import annotations

import os
import time
from pathlib import Path

WATCHED = 0.5
"""The processors are watched for this long [s]."""


def busy_processors() -> float | None:
    """How many processors others keep busy: now, or, where the system does not say it, over the last minute."""
    before = _jiffies()
    if before is None:
        return os.getloadavg()[0] if hasattr(os, "getloadavg") else None
    time.sleep(WATCHED)
    after = _jiffies()
    if after is None or after[1] <= before[1]:
        return None
    used, whole = (b - a for a, b in zip(before, after, strict=True))
    return used / whole * (os.cpu_count() or 1)


def _jiffies() -> tuple[int, int] | None:
    """Of all processors together the time that they worked, and all time; the idle fields are the fourth and fifth."""
    try:
        words = Path("/proc/stat").read_text(encoding="ascii").split("\n", 1)[0].split()
        numbers = [int(word) for word in words[1:9]]
    except (OSError, ValueError):
        return None
    return sum(numbers) - sum(numbers[3:5]), sum(numbers)
