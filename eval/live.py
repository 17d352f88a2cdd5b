"""SLAM over a recording that is still being written: when each scan was there, and when its pose was."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats import Follower
from moteslam.robot.issues import Issue
from moteslam.robot.ranges import chosen
from moteslam.robot.recording import Recording
from moteslam.robot.wording import counted
from moteslam.slam.config import SlamConfig
from moteslam.slam.inputs.complete import complete_scans
from moteslam.slam.inputs.odometry_path import odometry_path
from moteslam.slam.run import SlamSession
from moteslam.slam.scan_records import Update

Array = NDArray[np.float64]

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
        issues: what makes the result another than that of the finished file: scans that came too late, and figures
            of the lidar that the file did not show at first.
    """

    def __init__(self, follower: Follower, config: SlamConfig, *, seed: int = 0) -> None:
        self.session: SlamSession | None = None
        self._follower, self._config, self._seed = follower, config, seed
        self._arrivals: list[float] = []
        self._latencies: list[float] = []
        self._late = 0
        self._turned_out: dict[str, Issue] = {}

    def poll(self) -> bool:
        """Read what was written since the last call; whether anything was.

        Raises:
            InputError: as `Follower.poll`.
        """
        recording = self._follower.poll()
        if recording is None:
            return False
        self._go_on(recording)
        return True

    def take_in(self) -> Iterator[tuple[Update, float]]:
        """The scans that are complete, each with its latency [s]."""
        if self.session is not None:
            complete = complete_scans(self.session.recording, self._config.sync)
            yield from self._timed(self.session.take_in(complete))

    def finish(self) -> Iterator[tuple[Update, float]]:
        """The scans that are left, for which nothing more will be written.

        Raises:
            InputError: no scan was written, or as `Follower.poll`.
        """
        recording = self._follower.poll(last=True)
        assert recording is not None
        self._go_on(recording)
        if self.session is None:
            self.session = SlamSession(recording, self._config, seed=self._seed)
        yield from self._timed(iter(self.session))

    @property
    def issues(self) -> tuple[Issue, ...]:
        """See above."""
        late = f"{counted(self._late, 'scan')} left out, written after a later one was taken in"
        return (*((Issue("late-scans", late, self._late),) if self._late else ()), *self._turned_out.values())

    @property
    def latency(self) -> LatencySummary:
        """Of the scans until now."""
        if not self._latencies:
            return LatencySummary(0.0, 0.0, 0.0)
        median, most = np.quantile(self._latencies, (0.5, 0.99))
        return LatencySummary(float(median), float(most), max(self._latencies))

    def _go_on(self, recording: Recording) -> None:
        """Go on with all that has been written until now.

        Raises:
            InputError: the scans that were taken in are no longer there.
        """
        if self.session is not None:
            recording, self._late = without_late_scans(recording, self.session.taken)
            self._look_for_changes(self.session.recording, recording)
        scans = 0 if recording.lidar is None else len(recording.lidar)
        self._arrivals += [time.perf_counter()] * (scans - len(self._arrivals))
        if self.session is not None:
            self.session.extend(recording)
        elif self._may_begin(recording):
            self.session = SlamSession(recording, self._config, seed=self._seed)

    def _look_for_changes(self, before: Recording, now: Recording) -> None:
        """Note what the file shows otherwise now than when scans were taken in."""
        assert self.session is not None
        assert before.lidar is not None
        assert now.lidar is not None
        taken = len(self.session.taken)
        for name, there in (("range_max", now.lidar), ("angle_min", now.lidar), ("pose", now.platform.lidar)):
            old, new = (
                getattr(before.lidar if there is now.lidar else before.platform.lidar, name),
                getattr(there, name),
            )
            if taken and old != new:
                text = f"lidar {name}: {_shown(new)}, of which the first {counted(taken, 'scan')} did not know"
                self._turned_out[name] = Issue("turned-out", f"{text}: they were taken in with {_shown(old)}")

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


def without_late_scans(recording: Recording, taken: Array) -> tuple[Recording, int]:
    """A recording that has grown, without the scans that came after a later one was taken in.

    Args:
        recording: as it is now.
        taken: stamps [k] of the scans that were taken in [s], rising.

    Returns:
        the recording, whose first k scans are these, and how many were left out.

    Raises:
        InputError: these scans are not among those of the recording.
    """
    lidar = recording.lidar
    stamps = np.zeros(0) if lidar is None else lidar.stamps
    if np.array_equal(stamps[: len(taken)], taken):
        return recording, 0
    # of scans that share a stamp those that came first were taken in: streams keep them in the order of the file
    rank = np.arange(len(stamps)) - np.searchsorted(stamps, stamps, side="left")
    known = np.searchsorted(taken, stamps, side="right") - np.searchsorted(taken, stamps, side="left")
    kept = np.flatnonzero((rank < known) | (stamps >= taken[-1]))
    if lidar is None or not np.array_equal(stamps[kept[: len(taken)]], taken):
        problem = f"the stamps of {counted(len(taken), 'scan')} changed after they were taken in, expected them to stay"
        raise InputError(problem, file=recording.name, field="lidar")
    odometry = None if lidar.odometry is None else lidar.odometry[kept]
    fewer = replace(lidar, stamps=stamps[kept], ranges=chosen(lidar.ranges, kept), odometry=odometry)
    return recording.replace(lidar=fewer), len(stamps) - len(kept)


def _shown(value: float | Array) -> str:
    return ", ".join(f"{each:.4g}" for each in np.atleast_1d(value).tolist())
