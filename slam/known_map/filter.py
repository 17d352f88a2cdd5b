"""The filter of the method ``tsdf`` in a map that is known: the whole of it is searched, then the robot is tracked.

Monte Carlo localisation (Thrun, Burgard and Fox 2005, Probabilistic Robotics, chapter 8.3) with the improved proposal
of that filter: while several places are open the particles are divided among them by their probabilities, and KLD
sampling keeps few once one is left. A robot that its scans contradict is searched for again.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import ConfigError, InputError
from moteslam.kernels.scans import ThinnedScan
from moteslam.robot import se2
from moteslam.robot.formats.map_server import FREE, OCCUPIED, read_map
from moteslam.robot.raster import Raster
from moteslam.robot.se2 import Array, as_pose, compose_one
from moteslam.robot.values import Issue
from moteslam.slam.filter.certainty import Certainty, LocalisationState, certainty_of
from moteslam.slam.filter.protocol import StepResult
from moteslam.slam.filter.resampling import Draws, choose_parents, generator_for
from moteslam.slam.filter.update_policy import update_due
from moteslam.slam.filter.weights import Weights
from moteslam.slam.inputs.scans import Scans
from moteslam.slam.inputs.step import Step, thin
from moteslam.slam.known_map.config import KnownMapConfig
from moteslam.slam.known_map.hypotheses import LEAST, best_of, resample, shares, within
from moteslam.slam.known_map.maps import KnownMaps, MapScale, MapTears, thinned
from moteslam.slam.known_map.presence import Presence, expect_near, not_in_map
from moteslam.slam.known_map.search import (
    AGAIN,
    APART,
    DECIDED,
    IN_MAP,
    WINDOW,
    Hypotheses,
    WholeMapSearch,
    contradictions,
    passed,
    sight_of,
)
from moteslam.slam.mapping.config import LOST_DISTANCE, LOST_ROTATION, RESOLVED
from moteslam.slam.registration.localisation import CORRELATION
from moteslam.slam.tsdf.filter import WRONG_WHILE_LOST, TsdfFilter
from moteslam.slam.tsdf.motion import STILL, MotionSinceUpdate
from moteslam.slam.tsdf.particles import Particles
from moteslam.slam.tsdf.pose_covariance import PoseCovariance
from moteslam.slam.tsdf.proposal import Proposal
from moteslam.slam.tsdf.tracking import Tracked

NEW = 0.1  # Probability of a wrong pose, at least, until a place is proved: a single scan does not make it sure
SHOWN = 4  # Warnings of a robot that was searched for


class KnownMapFilter(TsdfFilter):
    """Localise in a known map; the first pose is unknown, or ``config.start``."""

    def __init__(self, config: KnownMapConfig, seed: int) -> None:
        super().__init__(config, seed)
        if not config.known_map:
            raise ConfigError("missing, expected the .yaml file of a map", field="known_map")
        self._known, self._given = config, (*config.start, *(0.0,) * 4)[:4]
        try:
            maps = KnownMaps(read_map(config.known_map), config.tsdf)
            walls, self._thinner_by = thinned(maps.occupancy) or (None, 0.0)
            self._drawn, self._thinner = maps, KnownMaps(walls, config.tsdf) if walls else None
            search = None if config.start else self._whole()
        except InputError as error:
            raise InputError(error.problem, file=error.file or config.known_map, field=error.field) from error
        if config.start:
            expect_near(maps.occupancy, *config.start[:2])
        self._maps = self._particles.maps = maps
        self._search: WholeMapSearch | None = search
        self._elsewhere: WholeMapSearch | None = None  # of a robot that may have been carried, while it is tracked on,
        self._unseen_until = 0.0  # and until when it saw nothing [s]
        self._doubt: Presence = Presence()
        self._given_up = self._most_given_up = 0
        self._divided = True  # the particles may be more than one place needs
        self._unweighed, self._begin = 0.0, 0  # path since hypotheses were weighed [m]; the first update of the search
        self._own: Particles | None = None  # with the map of what it has seen since it is searched for
        self._was_sure = self._was_there = False  # that the robot is in the map; over ``WINDOW``, too
        self._scale, self._tears = MapScale(maps), MapTears()
        self._led: Array | None = None  # where the start that was given and the odometry lead, until the robot is found
        self._start_off = 0.0, 0.0  # how far that start is off [m], [rad]
        # from when to when [s], how far off [m]; and how far the hypotheses of the last one are [H] [m]
        self._losses, self._off = list[tuple[float, float | None, float]](), np.zeros(1)

    def _whole(self, after: float = 0.0) -> WholeMapSearch:
        return WholeMapSearch(self._drawn, self._known.registration, self._thinner, after=after)

    def _take(self, maps: KnownMaps) -> None:
        """The map as drawn, or with thinner walls, whichever the robot is in."""
        if maps is not self._maps:
            self._maps = self._particles.maps = maps
            maps.resample(np.zeros(len(self._particles), np.int64))
            self._scale = MapScale(maps)

    @property
    def lost(self) -> bool:
        """Never: no map apart is drawn of what it sees."""
        return False

    @property
    def settled(self) -> bool:
        return self._search is None and super().settled

    @property
    def _is_sure(self) -> bool:
        return self._doubt.state is LocalisationState.SURE and self._doubt.proved and self._elsewhere is None

    @property
    def issues(self) -> tuple[Issue, ...]:
        """When it was not known where the robot is."""
        driven, is_sure = self._doubt.driven, self._search is None and self._is_sure
        open_ = bool(self._losses) and not (self._was_there or is_sure)
        if open_ and self._search is None and driven < WINDOW and not self._most_given_up:
            text = f"the robot was found, but has driven {driven:.1f} m since, too little to prove that it is there"
            return (Issue("searched-for", text),)
        if open_:
            return (not_in_map(self._drawn.occupancy, was_sure=self._was_sure),)
        issues = []
        if self._most_given_up > 1:
            text = f"{self._most_given_up} places, one after the other, did not fit for {WINDOW:g} m: the map may be "
            text += "of another place or scale, mirrored, incomplete or out of date, and sure poses may be wrong"
            issues.append(Issue("places-given-up", text))
        for begin, end, off in self._losses:
            text = f"from {begin:.2f} s on to the end the scans do not say where in the map the robot is: there the "
            text += "trajectory is that of odometry and scans alone"
            if end is not None:
                text = f"from {begin:.2f} to {end:.2f} s the robot was searched for in the whole map"
            if off > LOST_DISTANCE:
                text += f", and found {off:.1f} m from where the path until then led: it was carried, "
                text += "or the start that was given is wrong, " * bool(self._known.start)
                text += "or poses before that were said to be sure are wrong"
            if end != begin or off:  # it was not found at the first scan
                issues.append(Issue("searched-for", text))
        place, turn = self._start_off
        if place > LOST_DISTANCE + 3 * self._given[3] or turn > LOST_ROTATION + 3 * self._known.start_heading:
            text = f"the robot was found {place:.1f} m and {np.degrees(turn):.0f} degrees from the start that was "
            text += "given (x and y exchanged, another unit?): poses before mean nothing"
            issues.append(Issue("searched-for", text))
        if self._search is None and len(shares(self._particles)[0]) > 1:
            text = "to the end several places fit alike, as in a symmetric building: poses are those of the likeliest"
            issues.append(Issue("searched-for", text))
        if self._elsewhere is not None:
            text = f"from {self._unseen_until:.2f} s on the robot may be elsewhere: it saw nothing before, its wheels "
            text += "do not say that it drove, and its scans fit other places: it may have been carried there"
            issues.append(Issue("searched-for", text))
        if (more := len(issues) - SHOWN) > 1:
            last = f"and {more} times more it was searched for in the whole map, until {self._losses[-1][0]:.2f} s"
            issues[SHOWN:] = [Issue("searched-for", last, more)]
        if self._maps is self._thinner and self._was_sure:
            text = f"walls of the map are drawn {200 * self._thinner_by:.0f} cm too thick, as in a costmap or by a "
            text += "broad brush: rooms are too small for the scans, and thinner walls are taken. Draw them so"
            issues.append(Issue("map-scale", text))
        return (*issues, *filter(None, (self._scale.issue(), self._tears.issue())))

    def occupancy(self) -> Raster:
        """The map as an occupancy grid has it after one ray a cell."""
        known = self._maps.occupancy
        values = (known.values == OCCUPIED).astype(np.float32) - (known.values == FREE)
        return Raster(values * np.float32(self._config.map.limit), known.cell_size, known.origin)

    def revise(self, poses: Array, updates: NDArray[np.intp], scans: Scans) -> None:
        """The history was revised when the robot was found."""

    def step(self, step: Step) -> StepResult:
        if self._search is None:
            sure = self._is_sure
            self._was_sure |= sure
            self._was_there |= sure and self._doubt.driven > WINDOW
            first = not len(self.history)
            result = super().step(step)
            if self._led is not None:
                self._led = self._led if first else se2.compose(self._led, step.motion)
                if sure:
                    off, self._led = se2.between(self._led, result.pose), None
                    self._start_off = float(np.hypot(*off[:2])), abs(float(off[2]))
            if first and self._thinner and len(step.points) >= self._config.tracking.min_points:
                sight = sight_of(np.zeros(3), step, thin(step.points, step.origin, self._config.thinning))
                self._take(self._whole().find(sight, self._particles.poses).maps)
            known = sure and step.measured and step.stamp != self._unseen_until
            self._tears.add(step.stamp, result.pose, step.motion, known=known)
            self._scale.add(result.pose, step.points, step.origin, float(np.hypot(*step.motion[:2])), known=sure)
            return result
        return self._look(step, step.scan or thin(step.points, step.origin, self._config.thinning), self._search)

    def _start(self, scan: ThinnedScan) -> StepResult:
        """The first scan of a robot whose start is known."""
        x, y, theta, deviation = self._given
        spread = np.array((deviation, deviation, self._known.start_heading if deviation else 0.0))
        n = len(self._particles)
        normals = generator_for(self._seed, 0, Draws.PROPOSAL).standard_normal((n, 3))
        normals[0] = 0.0
        self._particles.poses = np.array((x, y, theta)) + normals * spread
        self._tracker.pose = as_pose(self._particles.poses[0])
        result, self._led = super()._start(scan), np.array((x, y, theta))
        self._unseen = False  # there is a map
        return result

    def _begin_anew(self, scan: ThinnedScan, tracked: Tracked) -> StepResult:
        """The robot is lost: from here on it is searched for in the whole map."""
        self._given_up = 0 if self._doubt.driven > WINDOW else self._given_up + 1
        self._most_given_up = max(self._most_given_up, self._given_up)
        self._begin = len(self.history) if self._elsewhere is None else self._begin
        self._search, self._elsewhere, self._led = self._whole(AGAIN), None, None
        pose = np.array(self._tracker.pose)
        return StepResult(pose, np.array(tracked.motion), 1.0, 0.0, False, False, self._certainty())

    def _look(self, step: Step, scan: ThinnedScan, search: WholeMapSearch) -> StepResult:
        """A scan of a robot that is searched for: it is tracked in a map of what it has seen since."""
        first, enough = not len(self.history), len(scan.points) >= self._config.tracking.min_points
        motion = self._tracker.predict(as_pose(step.motion), step.dt, measured=step.measured, left=step.open)
        moved, usable = STILL if first else motion.corrected, enough
        if self._own is not None:
            x, y = step.origin.tolist()
            tracked = self._tracker.track(motion, scan, (x, y), self._own)
            moved, usable = tracked.motion, enough and not tracked.lost
            if tracked.astray:
                self._own = None
                search.begin()
        else:
            self._tracker.pose = compose_one(self._tracker.pose, moved)
        self._since = self._since.plus(motion, moved, slipped=False)
        search.drive(0.0 if first else motion.distance + motion.rotation)
        if not self._losses or self._losses[-1][1] is not None:
            self._losses.append((step.stamp, None, 0.0))
        pose = np.array(self._tracker.pose)
        if not (first or update_due(self._config.update, self._since.travelled)):
            return StepResult(pose, np.array(moved), 1.0, 0.0, False, False, self._certainty())
        self._gather(pose)
        if usable:
            if self._own is None:
                self._own = Particles(1, self._config.tsdf)
            self._own.maps.integrate(pose[None], scan)
            sight = sight_of(pose, step, scan)
            search.see(sight)
        if usable and search.is_due():
            found = search.find(sight)
            if found.all_found and found.probabilities.sum() > IN_MAP:
                self._place(found, pose, step.stamp)
        return StepResult(self._pose(), np.array(moved), 1.0, 0.0, True, False, self._certainty())

    def _track(self, step: Step, scan: ThinnedScan) -> Tracked:
        """Track the robot; rays that nothing answered count for its doubt."""
        pose, sight = np.array(self._tracker.pose), sight_of(np.zeros(3), step, scan)
        rays = passed(self._maps, pose[None], sight.silent, step.origin, self._config.registration)
        self._doubt.passed = float(rays[0])
        tracked = super()._track(step, scan)
        if tracked.unseen:
            self._elsewhere, self._begin, self._unseen_until = self._whole(), len(self.history), step.stamp
        if self._elsewhere is not None:
            self._confirm(step, scan, self._elsewhere)
        return tracked

    def _confirm(self, step: Step, scan: ThinnedScan, search: WholeMapSearch) -> None:
        """Whether a robot that may have been carried is where it was; it is tracked on there while that is open."""
        search.drive(float(np.hypot(*step.motion[:2])))
        if len(scan.points) < self._config.tracking.min_points:
            return
        sight = sight_of(np.array(self._tracker.pose), step, scan)
        search.see(sight)
        if search.is_due():
            elsewhere = search.elsewhere(sight)
            self._elsewhere = search if elsewhere is None else None
            self._search = search if elsewhere else None  # from the next scan on it is lost

    def _register(self, step: Step, scan: ThinnedScan, places: Array) -> Proposal:
        """Register the scan from every particle; hypotheses are weighed against each other by what contradicts them."""
        proposal = super()._register(step, scan, places)
        particles = self._particles
        if not proposal.registered or super().settled:
            return proposal
        log_likelihood = within(particles, proposal.log_likelihood)
        self._unweighed += self._since.travelled.distance
        if self._unweighed >= APART:
            self._unweighed = 0.0
            tight, sight = np.array((*RESOLVED[:1], *RESOLVED)), sight_of(np.zeros(3), step, scan)
            _, against = contradictions(self._maps, proposal.means, tight, sight, self._config.registration)
            log_likelihood -= against / CORRELATION
        return replace(proposal, log_likelihood=log_likelihood)

    def _weigh(self, step: Step, proposal: Proposal) -> Proposal:
        """Weigh the particles; where another hypothesis becomes the best one, it is doubted anew."""
        before = int(self._particles.hypotheses[self.best_particle])
        proposal = super()._weigh(step, proposal)
        self._particles.best = best_of(self._particles, before)
        if self._particles.hypotheses[self.best_particle] != before:
            self._doubt = Presence(self._given_up)
        return proposal

    def _resample(self, step: Step, proposal: Proposal) -> tuple[Proposal, bool]:
        """Draw the particles anew; of each hypothesis some stay while there are several."""
        numbers, weight = shares(self._particles)
        if len(numbers) == 1 and self._losses and self._losses[-1][1] is not None:
            self._losses[-1] = (*self._losses[-1][:2], float(self._off[numbers[0]]))
        if len(numbers) == 1 and self._divided and proposal.registered:  # from here on few particles do
            self._divided, c, n = False, self._config, len(self._particles)
            parents = choose_parents(
                *(c.resampling, c.kld, n, proposal.means, self.weights.values), seed=self._seed, step=step.index
            )
            self._particles.resample(parents)
            return proposal.of(parents), True
        if len(numbers) == 1:
            return super()._resample(step, proposal)
        if not proposal.registered or weight.min() >= LEAST:
            return proposal, False
        return proposal.of(resample(self._particles, self._config.particles)), True

    def _gather(self, pose: Array) -> None:
        """All particles at one pose, as many as there may be: an update of the history."""
        particles, n = self._particles, self._config.particles
        if len(self.history) and len(particles) != n:
            self.history.resampled(np.zeros(n, np.int64))
        particles.poses, particles.hypotheses = np.repeat(pose[None], n, axis=0), np.zeros(n, np.int64)
        particles.weights, particles.best = Weights.uniform(n), 0
        self.history.append(particles.poses)
        if len(self._maps) != n:
            self._maps.resample(np.zeros(n, np.int64))
        self._since, self._mode_mean = MotionSinceUpdate(), STILL

    def _place(self, found: Hypotheses, pose: Array, stamp: float) -> None:
        """Divide the particles among the places where the robot may be; each takes its path since the loss along."""
        share = found.probabilities / found.probabilities.sum()
        share = np.where((share >= LEAST) & (share[0] < DECIDED), share, 0.0)
        share[0] = max(share[0], LEAST)
        n = len(self._particles)
        self._take(found.maps)
        chosen = np.searchsorted(np.cumsum(share) / share.sum(), (np.arange(n) + 0.5) / n)
        places = found.poses[chosen]
        self.history.move(self._begin, se2.compose(places, se2.between(pose, np.zeros(3))))
        self._particles.poses, self._particles.hypotheses = places, chosen
        self._relocated = self.history.path(0)
        self._tracker.pose = as_pose(places[0])
        self._covariance, self._doubt = PoseCovariance(self._config.registration), Presence(self._given_up)
        self._off = (self._was_sure or bool(self._known.start)) * np.hypot(*(found.poses - pose)[:, :2].T)
        self._losses[-1] = (self._losses[-1][0], stamp, float(self._off[chosen[0]]))
        self._search, self._own, self._divided = None, None, True

    def _certainty(self) -> Certainty:
        """How sure the online pose is: while several places are open, by the weight of the others, too."""
        if self._search is not None:  # it is anywhere in the map
            left, right, bottom, top = self._maps.occupancy.extent
            place = ((right - left) ** 2 + (top - bottom) ** 2) / 24  # of a uniform distribution, along either axis
            return Certainty(np.diag((place, place, np.pi**2 / 3)), np.nan, WRONG_WHILE_LOST)
        new = 0.0 if self._doubt.proved and self._elsewhere is None else NEW
        others = self._particles.hypotheses != self._particles.hypotheses[self.best_particle]
        wrong = max(self._doubt.probability, float(self.weights.values[others].sum()), new)
        return certainty_of(self._covariance.value, self._covariance.degenerate, wrong)
