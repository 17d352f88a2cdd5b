"""The map at stages of a run, kept for the figure that shows how it grew."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from moteslam.robot.raster import Raster
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update

STAGES = 6
"""Panels of the figure."""
SCANS = 250
"""At most this many scans are drawn into the map of a stage but the last: its panel is small."""


@dataclass(frozen=True, eq=False)
class Snapshot:
    """The map after the scan of this index and stamp [s]."""

    index: int
    stamp: float
    map: Raster


@dataclass(eq=False)
class Snapshots:
    """Watches a session and keeps its map after each sixth of the scans.

    Attributes:
        session: what is watched.
        kept: the maps so far.
    """

    session: SlamSession
    kept: list[Snapshot] = field(default_factory=list)

    def __post_init__(self) -> None:
        total = len(self.session)
        self._due = set((np.arange(1, STAGES + 1) * total // STAGES - 1).tolist())

    def look(self, update: Update) -> None:
        """Keep the map if this scan ends a stage."""
        if update.index in self._due:
            last = update.index == len(self.session) - 1
            occupancy = self.session.map if last else self.session.preview(SCANS)
            self.kept.append(Snapshot(update.index, update.stamp, occupancy))
