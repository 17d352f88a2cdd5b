"""What SLAM does with a scan, whatever it comes from: filter, back end, and the result so far."""

import math
import time
from array import array
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from functools import reduce
from importlib.metadata import version
from inspect import signature

import numpy as np

from moteslam.errors import ConfigError
from moteslam.robot import se2
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, expect_type, shortened
from moteslam.slam.backend.building import Building, between_known
from moteslam.slam.backend.protocol import BACKENDS, KeyScan
from moteslam.slam.config import METHODS, PRESETS, SlamConfig, load_preset
from moteslam.slam.estimate import Correction, Estimate, as_logged
from moteslam.slam.filter.certainty import certainty_of_particles, spread
from moteslam.slam.filter.protocol import Filter, StepResult
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.inputs import Inputs
from moteslam.slam.inputs.lapses import CLOSED, Open
from moteslam.slam.inputs.step import Step
from moteslam.slam.inputs.synchronise import about_jumps
from moteslam.slam.mapping.occupancy import draw_map
from moteslam.slam.rows import Rows
from moteslam.slam.scan_records import Losses, ScanRecords, Update

MakeFilter = Callable[[SlamConfig, int], Filter]
"""Makes a filter of a configuration and a seed: its class, for one."""
ASTRAY = 1.0  # The pose of an update is no mean of particles that are all farther away [m]


class Core:
    """Takes in steps of some inputs; see ``OnlineSlam``."""

    def __init__(self, config: SlamConfig | None, seed: int, method: MakeFilter | None, name: str) -> None:
        if config is not None:
            expect_type(config, SlamConfig, "config", "load_preset() gives one")
        if not isinstance(seed, int | np.integer) or not 0 <= seed < 2**63:
            raise ConfigError(f"{seed!r}, expected a whole number from 0 to 2^63 - 1", field="seed")
        self.config = config = config or load_preset()
        self.seed, self.name = seed, name
        self._filter = _made(METHODS[config.method].make if method is None else method, config, seed)
        self._backend = BACKENDS[config.backend.method].make(config.backend)
        self._taken: Inputs | None = None
        self._records = ScanRecords()
        self._updates = array("q")
        self._waiting: list[KeyScan] = []  # for the back end, until the filter is settled
        self._spreads = Rows(3)
        self._corrections: list[Correction] = []
        self._losses = Losses()
        self._drawn: tuple[int, Raster | None] = (0, None)  # the map, and after how many scans

    @property
    def _inputs(self) -> Inputs:
        if self._taken is None:
            raise ConfigError("no scan was taken in yet, expected some first")
        return self._taken

    @property
    def map(self) -> Raster:
        """The map as it stands: the filter's own, or drawn along the best particle's path."""
        done, drawn = self._drawn
        if drawn is None or done != self._done:
            drawn = self.preview(self._done)
            self._drawn = self._done, drawn
        return drawn

    def preview(self, scans: int) -> Raster:
        """The map as it stands, for a small picture: of at most ``scans`` scans, evenly chosen."""
        own = self._filter.occupancy()
        return self._draw(self._path(), scans) if own is None else own

    def estimate(self) -> Estimate:
        """The result of the scans taken in until now.

        Raises:
            ConfigError: none was.
        """
        if not self._done:
            raise ConfigError("no scan was taken in yet, expected some first")
        n, records = self._done, self._records
        stamps, updates = self._inputs.stamps[:n], np.array(self._updates)
        history, odometry = self._filter.history, self._inputs.odometry[:n]
        path, particles = self._path(), np.arange(history.particles)
        began = time.perf_counter()
        corrected = self._backend.finish(path)
        finishing = time.perf_counter() - began
        driven = se2.accumulate(records.motions)
        placed = between_known(path if corrected is None else corrected, updates, driven)
        final, building = Trajectory(stamps, self._losses.parted(placed, updates, driven)), None
        if measured := getattr(self._backend, "measured", None):  # back ends of other packages may have none
            building = Building.of(measured, final, self._inputs.scans, self._losses.drawn(measured.nodes))
        found = Estimate(
            name=self.name,
            config=self.config,
            seed=self.seed,
            versions={name: version(name) for name in ("moteslam", "taichi", "numpy")},
            trajectory=Trajectory(stamps, records.poses),
            trajectory_final=final,
            dead_reckoning=Trajectory(stamps, se2.between(odometry[0], odometry)),
            map=self.map if corrected is None else self._draw(corrected, n),
            particle_stamps=stamps[updates],
            particle_paths=history.paths(particles),
            particle_ancestors=history.ancestors(particles),
            particle_spread=self._spreads.values.copy(),
            covariances=records.covariances,
            diagnostics=records.diagnostics,
            warnings=self._warnings(),
            seconds=float(records.diagnostics["seconds"].sum()) + finishing,
            corrections=tuple(self._corrections),
            loops=self._backend.loops,
            building=building,
        )
        return found if self._inputs.logged is None else as_logged(found, self._inputs.logged[:n])

    @property
    def _done(self) -> int:
        return len(self._records)

    def _step(self, step: Step) -> Update:
        began, draws = time.perf_counter(), self._filter.history.draws
        result, corrected = self._filter.step(step), 0.0
        if problem := _unsound(self._filter, result, len(self._updates), draws):
            raise ConfigError(problem, field=f"{type(self._filter).__name__}.step")
        if result.updated:
            self._updates.append(step.index)
            self._waiting.append(self._key_scan(step))
            if self._filter.settled:
                corrected = self._hand_over(step.index)
            corrected += self._relocate(step.index)
            doubted_from = self._records.last_sure + 1
            self._losses.note(self._filter.lost, step.stamp, doubted_from=doubted_from, scan=step.index)
        seconds = time.perf_counter() - began
        poses, weights = self._filter.poses, self._filter.weights.values
        if result.updated:
            self._spreads.add(spread(poses, weights)[None])
        certainty = result.certainty or certainty_of_particles(poses, weights, result.pose)
        weighed = self._filter.history.weighed or (poses, weights)
        known = result.pose, *weighed, *result[2:6], seconds, corrected
        update = Update(step.index, step.stamp, *known, *certainty)
        self._records.add(update, result.motion)
        return update

    def _settle(self) -> None:
        """Give the back end what still waits: nothing more is to come."""
        began = time.perf_counter()
        if self._waiting:
            corrected = self._hand_over(self._done - 1)
            self._records.add_to_last(seconds=time.perf_counter() - began, corrected=corrected)

    def _key_scan(self, step: Step) -> KeyScan:
        """The scan that the filter was updated with last, at the best particle's pose."""
        last = self._updates[-2] if len(self._updates) > 1 else step.index
        odometry, best = self._inputs.odometry, self._filter.best_particle
        left = (more for scan, more in self._inputs.open.items() if last < scan <= step.index)
        return KeyScan(
            index=step.index,
            stamp=step.stamp,
            points=step.points.copy(),  # not the block that it lies in
            origin=step.origin,
            pose=self._filter.history.last[best].copy(),
            odometry=np.asarray(se2.between(odometry[last], odometry[step.index])),
            measured=bool(self._inputs.measured[last + 1 : step.index + 1].all()),
            motion=self._filter.history.step(best),
            lost=self._filter.lost,
            left_open=reduce(Open.plus, left, CLOSED),
        )

    def _relocate(self, scan: int) -> float:
        """Move the path since the robot was lost to where the filter has found it again; how far that moved it [m]."""
        if (path := self._filter.relocated()) is None:
            return 0.0
        before = self._filter.history.last[self._filter.best_particle].copy()
        self._filter.revise(path, np.array(self._updates), self._inputs.scans)
        self._backend.relocated(path[: len(path) - len(self._waiting)])
        self._corrections.append(Correction(scan, path))
        return float(np.hypot(*(path[-1] - before)[:2]))

    def _hand_over(self, scan: int) -> float:
        """Give the back end the key scans that wait; where it corrects the path, the filter goes on from there.

        Those that waited while the particles were at several places are given on the path that turned out to be best.
        Returns how far that moved the robot [m], 0 where nothing was corrected.
        """
        keys, self._waiting = self._waiting, []
        first = len(self._updates) - len(keys)
        begin = max(first - 1, 0)  # from the update before those that wait on
        history, best = self._filter.history, self._filter.best_particle
        path = history.path(best, begin) if len(keys) > 1 else None
        before = history.last[best].copy()
        now = before
        for k, key in enumerate(keys, start=first):
            if path is not None:
                pose, after = path[k - begin], path[k - begin + 1 :]
                motion = se2.between(path[k - begin - 1], pose) if k else np.zeros(3)
                key = replace(key, pose=pose, motion=np.asarray(motion))
            if (revised := self._backend.add(key)) is None:
                continue
            if path is not None:
                revised = np.vstack((revised, se2.compose(revised[-1], se2.between(pose, after))))
                path = revised[begin:]
            self._filter.revise(revised, np.array(self._updates), self._inputs.scans)
            now = revised[-1]
            self._corrections.append(Correction(scan, revised))
        return float(np.hypot(*(now - before)[:2]))

    def _path(self) -> Array:
        """The path [u, 3] of the best particle at every update."""
        return self._filter.history.path(self._filter.best_particle)

    def _draw(self, path: Array, scans: int) -> Raster:
        """The occupancy map along a path [u, 3], of at most ``scans`` scans, evenly chosen."""
        updates = np.array(self._updates)[: len(path)]
        parts = np.flatnonzero(self._losses.drawn(updates))
        some = parts[np.unique(np.linspace(0, len(parts) - 1, min(len(parts), scans)).round().astype(int))]
        return draw_map(self.config.map, self._inputs.scans, updates[some].tolist(), path[some]).snapshot()

    def _warnings(self) -> tuple[Issue, ...]:
        """What SLAM had to do without."""
        issues, inputs, n = list[Issue](), self._inputs, self._done
        if not METHODS[self.config.method].needs_odometry:
            issues += about_jumps(inputs.stamps[:n], inputs.odometry[:n], inputs.jumped[:n])
        issues += self._losses.issues(self._records.diagnostics["state"])
        issues += self._filter.issues
        issues += getattr(self._backend, "issues", ())  # back ends of other packages may have none
        return tuple(issues)


def _unsound(made: Filter, result: object, updates: int, draws: int) -> str:
    """What a run cannot go on with of a filter of one's own; ``updates`` and ``draws`` are those before."""
    if not isinstance(result, StepResult):
        return f"returned {type(result).__name__}, expected a StepResult"
    if np.shape(result.pose) != (3,) or not all(map(math.isfinite, result.pose)):
        return f"returned the pose {shortened(np.asarray(result.pose).tolist())}, expected x, y and theta"
    if not result.updated:
        return "" if updates else "did not update with the first scan, expected updated=True there"
    history, weights, best = made.history, getattr(made, "weights", None), getattr(made, "best_particle", None)
    if len(history) != updates + 1:
        return f"kept {len(history)} of {updates + 1} updates, expected self.history.append(self.poses) at each"
    if not isinstance(weights, Weights) or len(weights.log) != len(made.poses):
        return f"left weights of type {type(weights).__name__}, expected Weights, one for each of self.poses"
    if not isinstance(best, int | np.integer) or not 0 <= best < len(history.last):
        return f"left best_particle {shortened(best)}, expected an index into self.poses"
    if result.resampled and len(history.last) > 1 and history.draws == draws:
        return "resampled, expected self.history.resampled(parents), or paths would be those of other particles"
    if (off := float(np.hypot(*(history.last[:, :2] - result.pose[:2]).T).min())) > ASTRAY:
        return f"returned a pose {off:.2f} m from all of self.history.last, expected poses that are kept up to date"
    return ""


def _made(method: MakeFilter, config: SlamConfig, seed: int) -> Filter:
    """The filter of a run; refused where it is none."""
    if not callable(method):
        text = f"{shortened(method)}, expected a class of a filter; a name is a key of the configuration: method=NAME"
        raise ConfigError(text, field="method")
    name = getattr(method, "__name__", type(method).__name__)
    try:
        with suppress(ValueError):  # it has no signature
            signature(method).bind(config, seed)
    except TypeError as error:
        text = f"{name} takes other arguments, expected {name}(config, seed) as of examples/my_filter.py"
        raise ConfigError(text, field="method") from error
    try:
        made = method(config, seed)
    except AttributeError as error:
        if error.obj is not config:
            raise
        having = (preset for preset, of in PRESETS.items() if str(error.name) in METHODS[of].config.model_fields)
        preset = next(having, "of the method that yours is made of")
        text = f'the configuration of "{config.method}" has no {error.name}, expected that of the preset {preset}'
        raise ConfigError(text, field="method") from error
    has = dir(made)  # asks for no value, as hasattr does
    missing = [name for name in dir(Filter) if not name.startswith("_") and name not in has]
    if missing:
        text = f"{type(made).__name__} has no {', '.join(missing)}, expected a class under FilterDefaults with a step"
        raise ConfigError(text, field="method")
    return made
