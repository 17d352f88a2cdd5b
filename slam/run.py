"""Running SLAM over a recording: all at once, or a step at a time for whoever wants to watch."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.robot import se2
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import Trajectory
from moteslam.slam.colouring import with_texture
from moteslam.slam.config import SlamConfig
from moteslam.slam.dead_reckoning import dead_reckon
from moteslam.slam.estimate import Estimate
from moteslam.slam.floor_views import FloorViews, lacking
from moteslam.slam.grid import OccupancyMap, draw_map
from moteslam.slam.paper_filter import PaperFilter
from moteslam.slam.scans import Scans
from moteslam.slam.settings import load_preset
from moteslam.slam.step import steps
from moteslam.slam.surface_filter import SurfaceFilter
from moteslam.slam.synchronise import has_odometry, require_lidar, tells_motion, warnings

FILTERS: dict[str, type[PaperFilter] | type[SurfaceFilter]] = {"paper": PaperFilter, "surface": SurfaceFilter}
"""The methods that ``SlamConfig.method`` names."""


@dataclass(frozen=True, eq=False)
class Update:
    """What is known after a scan.

    Attributes:
        index, stamp: of the scan; stamp in s.
        pose: [3] estimate at the scan.
        poses, weights: [N, 3] and [N] of the particles, at the last scan that the filter worked on.
        n_eff, score, mapped, resampled: see ``Outcome``; ``mapped`` when the filter worked on this scan.
        seconds: spent on it.
    """

    index: int
    stamp: float
    pose: NDArray[np.float64]
    poses: NDArray[np.float64]
    weights: NDArray[np.float64]
    n_eff: float
    score: float
    mapped: bool
    resampled: bool
    seconds: float


class SlamSession:
    """SLAM over one recording, an ``Update`` a scan when iterated; ``estimate()`` at the end.

    Args:
        recording: with a lidar; with some odometry, too, unless the method does without. There is no truth in it.
        config: the ``DEFAULT_PRESET`` if None.
        seed: from 0 to 2^63 - 1; the same seed gives the same bytes, on one thread and on many.

    Raises:
        InputError: the recording has no scans, or no odometry and the method needs one.
        ConfigError: the seed is out of bounds.
    """

    def __init__(self, recording: Recording, config: SlamConfig | None = None, *, seed: int = 0) -> None:
        if not 0 <= seed < 2**63:
            raise ConfigError(f"{seed}, expected 0 to 2^63 - 1", field="seed")
        self.recording = recording
        self.config = config or load_preset()
        self.seed = seed
        self._lidar = require_lidar(recording)
        method = FILTERS[self.config.method]
        self._dead_reckoning = self._reckon(method.needs_odometry)
        self._filter = method(self.config, seed)
        self._online = np.zeros((len(self._lidar), 3))
        self._diagnostics = {
            key: np.zeros(len(self._lidar))
            for key in ("particles", "n_eff", "score", "updated", "resampled", "seconds")
        }
        self._motions = np.zeros((len(self._lidar), 3))
        self._done = self._guesses = 0
        self._drawn: tuple[int, OccupancyMap | None] = (0, None)  # the map, and after how many scans
        self._blind = lacking(recording) if self.config.colours.enabled else ""
        wanted = self.config.colours.enabled and not self._blind
        self._views = FloorViews(recording, self.config) if wanted else None
        self._steps = steps(recording, self.config.sync, max_range=self.config.max_range, views=self._views)

    def __len__(self) -> int:
        return len(self._lidar)

    def __iter__(self) -> Iterator[Update]:
        for step in self._steps:
            began = time.perf_counter()
            outcome = self._filter.step(step)
            self._guesses += step.guess
            seconds = time.perf_counter() - began
            poses = self._filter.poses
            self._online[step.index] = outcome.pose
            self._motions[step.index] = outcome.motion
            for key, value in (
                ("particles", len(poses)),
                ("n_eff", outcome.n_eff),
                ("score", outcome.score),
                ("updated", outcome.updated),
                ("resampled", outcome.resampled),
                ("seconds", seconds),
            ):
                self._diagnostics[key][step.index] = value
            self._done = step.index + 1
            yield Update(
                step.index,
                step.stamp,
                outcome.pose,
                poses,
                self._filter.weights.values,
                outcome.n_eff,
                outcome.score,
                outcome.updated,
                outcome.resampled,
                seconds,
            )

    def _reckon(self, needs_odometry: bool) -> Trajectory:
        """Dead reckoning; standing still where a recording has no odometry and the method can do without."""
        if has_odometry(self.recording):
            return dead_reckon(self.recording, self.config.sync)
        if needs_odometry:
            able = ", ".join(f'"{name}"' for name, method in FILTERS.items() if not method.needs_odometry)
            raise InputError(
                f"neither encoders nor odometry, expected one of them with method {self.config.method!r}; "
                f"method {able} does without",
                file=self.recording.name,
            )
        return Trajectory(self._lidar.stamps, np.zeros((len(self._lidar), 3)))

    def _distrust(self) -> list[str]:
        """Where the odometry was not believed, a line if anywhere."""
        if not self._guesses or self._filter.needs_odometry or not tells_motion(self.recording):
            return []
        return [f"odometry jumps at {self._guesses} of {self._done} scans: constant velocity there"]

    def _unseen(self) -> tuple[str, ...]:
        """Where the colours of the floor were asked for and not to be had, a line each."""
        if self._blind:
            return (f"colours: {self._blind}: particles are weighed without",)
        return self._views.warnings() if self._views is not None else ()

    @property
    def map(self) -> OccupancyMap:
        """The map as it stands; the best particle's, where each has its own."""
        done, drawn = self._drawn
        if drawn is None or done != self._done:
            drawn = self.sketch(self._done)
            self._drawn = self._done, drawn
        return drawn

    def sketch(self, scans: int) -> OccupancyMap:
        """The map as it stands, for a small picture: of an even choice of so many scans, where it has to be drawn."""
        if isinstance(self._filter, PaperFilter):
            return self._filter.grid.snapshot()
        path = self._filter.history.paths(np.array([self._filter.best_particle]))[0]
        updates = np.flatnonzero(self._diagnostics["updated"])[: len(path)]
        some = np.unique(np.linspace(0, len(path) - 1, min(len(path), scans)).round().astype(int))
        points = Scans(self.recording, self.config.sync, max_range=self.config.max_range)
        return draw_map(self.config.map, points, updates[some].tolist(), path[some])

    def estimate(self) -> Estimate:
        """The result of the scans taken in so far.

        Raises:
            ConfigError: none was: iterate first.
        """
        if not self._done:
            raise ConfigError("no scan was taken in yet, expected an iteration over the session first")
        n = self._done
        stamps = self._lidar.stamps[:n]
        updates = np.flatnonzero(self._diagnostics["updated"][:n])
        paths = self._filter.history.paths(np.arange(self._filter.history.particles))
        odometry = self._dead_reckoning.poses[:n]
        final = _between_updates(paths[self._filter.best_particle], updates, se2.accumulate(self._motions[:n]))
        return Estimate(
            name=self.recording.name,
            config=self.config,
            seed=self.seed,
            versions={name: version(name) for name in ("moteslam", "taichi", "numpy")},
            trajectory=Trajectory(stamps, self._online[:n]),
            trajectory_final=Trajectory(stamps, final),
            dead_reckoning=Trajectory(stamps, odometry),
            map=self.map,
            particle_stamps=stamps[updates],
            particle_paths=paths,
            diagnostics={key: values[:n] for key, values in self._diagnostics.items()},
            warnings=(*warnings(self.recording), *self._distrust(), *self._unseen()),
            seconds=float(self._diagnostics["seconds"].sum()),
        )


def run_slam(
    recording: Recording,
    config: SlamConfig | None = None,
    seed: int = 0,
    watch: Callable[[Update], None] | None = None,
) -> Estimate:
    """Run SLAM over a recording, and colour the floor along what it found where there are images.

    Args:
        recording: with a lidar; with some odometry, too, unless the method does without.
        config: the ``DEFAULT_PRESET`` if None.
        seed: of all randomness.
        watch: called after every scan.

    Raises:
        InputError, ConfigError: see ``SlamSession``.
    """
    session = SlamSession(recording, config, seed=seed)
    for update in session:
        if watch is not None:
            watch(update)
    return with_texture(session.estimate(), recording)


def _between_updates(
    path: NDArray[np.float64], updates: NDArray[np.intp], odometry: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Fill the poses between updates [u] of a path [u, 3] along the odometry [n, 3], shape [n, 3].

    Odometry from the update before and back from the update after do not quite meet; the misfit is spread evenly
    over the scans between.
    """
    scans = np.arange(len(odometry))
    before = np.clip(np.searchsorted(updates, scans, side="right") - 1, 0, len(updates) - 1)
    after = np.minimum(before + 1, len(updates) - 1)
    forward = se2.compose(path[before], se2.between(odometry[updates[before]], odometry))
    backward = se2.compose(path[after], se2.between(odometry[updates[after]], odometry))
    span = updates[after] - updates[before]
    share = np.where(span > 0, (scans - updates[before]) / np.maximum(span, 1), 0.0)[:, None]
    misfit = backward - forward
    misfit[:, 2] = se2.wrap(misfit[:, 2])
    poses = forward + share * misfit
    poses[:, 2] = se2.wrap(poses[:, 2])
    return np.asarray(poses)
