"""Issues: what was dropped, repaired or missing in a recording or a run, as text, JSON and Python share it."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any


@dataclass(frozen=True)
class Issue:
    """Something that was dropped, repaired or missing; printed, it is its message.

    Attributes:
        code: its kind, such as ``stamps-go-back``; stable, to filter and count by (``docs/reference/formats.md``).
        message: one line for people, with the file and the numbers.
        count: how many readings, frames, scans, lines or images it concerns; 1 for a whole stream or run.
    """

    code: str
    message: str
    count: int = 1

    def __str__(self) -> str:
        return self.message

    def as_dict(self) -> dict[str, Any]:
        """The same as plain values, fit for JSON."""
        return asdict(self)
