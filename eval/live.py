"""SLAM over a recording that is still being written: when each scan was there, and when its pose was."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from moteslam.errors import InputError
from moteslam.robot.formats import Follower
from moteslam.robot.recording import Recording
from moteslam.slam.config import SlamConfig
from moteslam.slam.inputs.complete import complete_scans
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.run import SlamSession, Update

ODOMETRY_WAIT = 1.0
"""The first scans wait this long for odometry [s of the recording], and are then taken in without."""


@dataclass(frozen=True)
class LatencySummary:
    """Latencies of a run [s]: from when a scan was in the file to its pose.

    Attributes:
        median, quantile_99, longest: over its scans; 0 without scans.
    """

    median: float
    quantile_99: float
    longest: float


class Live:
    """SLAM over what a follower reads.

    Args:
        follower: of the file.
        config: of SLAM.
        seed: of all randomness.

    Attributes:
        session: None until the recording has a scan, and odometry or none for `ODOMETRY_WAIT`.
    """

    def __init__(self, follower: Follower, config: SlamConfig, *, seed: int = 0) -> None:
        self.session: SlamSession | None = None
        self._follower, self._config, self._seed = follower, config, seed
        self._latest: Recording | None = None
        self._arrivals: list[float] = []
        self._latencies: list[float] = []

    def poll(self) -> bool:
        """Read what was written since the last call; whether anything was.

        Raises:
            InputError: as `Follower.poll`.
        """
        recording = self._follower.poll()
        if recording is None:
            return False
        self._latest = recording
        scans = 0 if recording.lidar is None else len(recording.lidar)
        self._arrivals += [time.perf_counter()] * (scans - len(self._arrivals))
        if self.session is not None:
            self.session.extend(recording)
        elif self._may_begin(recording):
            self.session = SlamSession(recording, self._config, seed=self._seed)
        return True

    def take_in(self) -> Iterator[tuple[Update, float]]:
        """The scans that are complete, each with its latency [s]."""
        if self.session is not None:
            assert self._latest is not None
            yield from self._timed(self.session.take_in(complete_scans(self._latest, self._config.sync)))

    def finish(self) -> Iterator[tuple[Update, float]]:
        """The scans that are left, for which nothing more will be written.

        Raises:
            InputError: no scan was written.
        """
        if self.session is None:
            if self._latest is None:
                raise InputError("nothing was written, expected a recording that is being written")
            self.session = SlamSession(self._latest, self._config, seed=self._seed)
        yield from self._timed(iter(self.session))

    @property
    def latency(self) -> LatencySummary:
        """Of the scans until now."""
        if not self._latencies:
            return LatencySummary(0.0, 0.0, 0.0)
        median, most = np.quantile(self._latencies, (0.5, 0.99))
        return LatencySummary(float(median), float(most), max(self._latencies))

    def _timed(self, updates: Iterator[Update]) -> Iterator[tuple[Update, float]]:
        for update in updates:
            self._latencies.append(time.perf_counter() - self._arrivals[update.index])
            yield update, self._latencies[-1]

    def _may_begin(self, recording: Recording) -> bool:
        lidar = recording.lidar
        if lidar is None or not len(lidar):
            return False
        waited = lidar.stamps[-1] - lidar.stamps[0] > ODOMETRY_WAIT
        return bool(waited) or odometry_path(recording, self._config.sync) is not None
