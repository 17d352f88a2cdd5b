"""The chain: the steps from node to node, by registration, odometry and the filter together.

Every node is registered twice: with the recorded odometry, to learn the odometry's errors, and with the corrected
odometry, which only evidence overrules.
"""

from copy import deepcopy

import numpy as np

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.graph.nodes import Nodes
from moteslam.slam.backend.graph.odometry_model import OdometryModel, fit_odometry, turned_aside
from moteslam.slam.backend.graph.pose_graph import MeasuredChain
from moteslam.slam.backend.graph.step_registration import AGREEING, Prediction, RegisteredStep, StepRegistration
from moteslam.slam.mapping.config import RESOLVED
from moteslam.slam.registration.registrar import prior_spread

FLOOR = np.diag(np.square([RESOLVED[0], *RESOLVED]))  # The covariance [3, 3] of the error that every step has besides
DOUBTED = 2.0  # Registration and odometry so many deviations of both apart contradict each other
LATEST, MADE_UP = 3, 0.5
"""A late pose of the odometry has come after so many steps, and then no more than this share is left of what the first
of them lacked: a filter that a door has fooled by a metre is still off by it."""
OPEN = 0.5  # A step is the filter's where the odometry leaves so much open [m]: it has searched for the robot
MAPPED = np.array((0.05, 0.05, 0.01))
"""Standard deviations of the filter's step over places that it knows: its map is corrected where a loop is off by as
much [m], [rad]."""
LEAST_INFORMATION = 1e-2  # That every step has besides [1/m^2], [1/rad^2]: one that was not registered has no other
FITS = (16, 64, 256)  # The odometry's errors are fitted at so many steps; of a run of fewer than the last, at the end
SAME_STEP, SAME_SPREAD = 0.5, 1.5
"""The registrations stand where a new fit moves no step by more than this many standard deviations, and changes no
standard deviation by more than this factor."""


class Chain:
    """The steps between the nodes; it grows with them."""

    def __init__(self, nodes: Nodes, config: GraphConfig) -> None:
        self._nodes, self._config = nodes, config
        self._plain: list[RegisteredStep] = []  # with the recorded odometry, the first
        self._proved: list[RegisteredStep] = []  # with the corrected one
        self._raw: list[Prediction] = []
        self._predicted: list[Prediction] = []
        self._model: OdometryModel | None = None
        self._steps: list[Array] = []  # registration, odometry and the filter together: [3] each, ...
        self._covariance: list[Array] = []  # ... and [3, 3]
        self._apart: tuple[int, StepRegistration] | None = None  # where the filter began to contradict the odometry
        self._begin()
        self.fits = 0  # how often all steps changed, since the odometry's errors were fitted anew

    def __len__(self) -> int:
        return len(self._raw)

    @property
    def steps(self) -> Array:
        """[n - 1, 3] in the frames where they begin."""
        return np.array(self._steps).reshape(-1, 3)

    @property
    def covariance(self) -> Array:
        """[n - 1, 3, 3] of them, in the frames where they end."""
        return np.array(self._covariance).reshape(-1, 3, 3)

    @property
    def measured(self) -> MeasuredChain:
        """The steps as they are now.

        For a joint registration, where registration and odometry contradict each other, either may be right: the step
        is spread as far as they are apart, since all scans together are the better judge. Where the registration has
        overruled the odometry without the filter, or alone contradicts both, it is the odometry's. All are doubtful,
        and so is a step that was not registered. Its heading remains the registration's, which scans know best; the
        odometry turns by half of what that differs.
        """
        steps, covariance = self.steps, self.covariance
        predicted = np.array([each.step for each in self._predicted]).reshape(-1, 3)
        spread = np.array([each.spread for each in self._predicted]).reshape(-1, 3)
        found = np.array([each.step for each in self._proved]).reshape(-1, 3)
        off = se2.wrap(found[:, 2] - predicted[:, 2])
        turned = se2.compose(np.column_stack((np.zeros((len(off), 2)), off / 2)), predicted)
        predicted = np.column_stack((turned[:, :2], found[:, 2]))
        known = np.array([_deviations(each.information) for each in self._proved]).reshape(-1, 3)
        apart, both = np.abs(se2.between(found, predicted)), np.hypot(spread, known)
        doubted, overruled = ((apart >= most * both).any(axis=1) for most in (DOUBTED, AGREEING))
        unregistered = np.array([not each.information.any() for each in self._proved], bool)
        filtered = np.array([each.filtered for each in self._predicted]).reshape(-1, 3)
        near, far = (np.abs(se2.between(one, filtered)[:, :2]) / spread[:, :2] for one in (predicted, found))
        driven = np.array([each.measured for each in self._predicted], bool)
        overruled &= ~np.array([each.by_filter for each in self._proved], bool)
        overruled |= doubted & driven & (near < 1).all(axis=1) & (far > DOUBTED).any(axis=1)
        steps[overruled] = predicted[overruled]
        wide = np.square(spread) + np.square(se2.between(steps, predicted))  # 0 apart where it is the odometry's
        covariance[doubted] = wide[doubted][:, None] * np.eye(3)
        return MeasuredChain(self.steps, self.covariance, steps, covariance, doubted | unregistered)

    def add(self) -> Array:
        """Register the latest node to those before it; the step [3] to it."""
        k = len(self) + 1
        self._raw.append(self._unregistered(k))
        if len(self) <= FITS[-1]:
            self._plain.append(self._plainly.add(self._nodes.scans[k], self._raw[-1]))
        if len(self) in FITS:
            self.fit()
        if len(self._proved) < len(self):
            self._register(k)
        return self._steps[-1]

    def settle(self) -> None:
        """Fit the odometry's errors at the end and register the nodes anew, unless the errors are known well."""
        if len(self) < FITS[-1]:
            self.fit(anew=True)

    def renew(self) -> None:
        """Register all nodes anew, with what the filter says of the steps now."""
        self._raw = [self._unregistered(k) for k in range(1, len(self) + 1)]
        self.fit(anew=True)

    def fit(self, *, anew: bool = False) -> None:
        """Fit the odometry's errors to the first steps; register the nodes anew where that changes it, or ``anew``."""
        if not self._raw:
            return
        plain = np.array([found.step for found in self._plain])
        information = np.array([found.information for found in self._plain])
        covariance = np.asarray(np.linalg.inv(information + LEAST_INFORMATION * np.eye(3)))
        self._model = fit_odometry(np.array([raw.step for raw in self._raw[: len(plain)]]), plain, covariance)
        predicted = [self._corrected(raw) for raw in self._raw]
        if self._proved and not anew and _same(self._predicted, predicted[: len(self._predicted)]):
            return
        self._begin(plainly=False)
        for k in range(1, len(self) + 1):
            self._register(k)
        self.fits += 1

    def _begin(self, *, plainly: bool = True) -> None:
        scan, origin = self._nodes.scans[0], self._nodes.origin
        if plainly:
            self._plainly = StepRegistration(scan, origin, self._config, proved=False)
        self._provenly = StepRegistration(scan, origin, self._config, proved=True)
        self._proved, self._predicted, self._steps, self._covariance = [], [], [], []
        self._apart = None

    def _unregistered(self, k: int) -> Prediction:
        """A step by the recorded odometry; what it leaves open is taken from the filter, loosely."""
        filtered, measured = self._nodes.filtered[k], self._nodes.measured[k]
        step = self._nodes.odometry[k] if measured else filtered
        distance, rotation = float(np.hypot(*step[:2])), abs(float(step[2]))
        error = prior_spread(self._config.registration, distance, rotation, measured=measured)
        spread = turned_aside(step, error)
        left = self._nodes.left_open[k]
        if any(left):  # a lapse, after which the filter has searched
            spread = np.hypot(spread, (left.place, left.place, left.heading))
            return Prediction(filtered, spread, False, filtered, bool(spread[:2].max() > OPEN))
        if self._nodes.through[k]:  # the filter's map holds both ends
            return Prediction(filtered, MAPPED, False, filtered, True)
        if spread[:2].max() > OPEN:
            return Prediction(filtered, turned_aside(filtered, error), False, filtered, True)
        return Prediction(step, spread, measured, filtered)

    def _corrected(self, raw: Prediction) -> Prediction:
        """The same by the corrected odometry, as far as its errors are known yet."""
        if self._model is None or not raw.measured:
            return raw
        step = raw.step[None]
        return raw._replace(step=self._model.corrected(step)[0], spread=self._model.spread(step)[0])

    def _register(self, k: int) -> None:
        """Register a node with the corrected odometry; anew, with those before it, where their poses came late.

        Odometry whose pose came late lacks in one step what it has too much in the next; then filter and odometry
        contradict each other in both, and agree over both together.
        """
        predicted = self._corrected(self._raw[k - 1])
        if self._apart is None and predicted.contradicted:
            self._apart = k, deepcopy(self._provenly)
        self._add(k, predicted)
        if self._apart is None or k == self._apart[0]:
            return
        first, before = self._apart
        run = self._predicted[first - 1 :]
        if _made_up(run):
            self._provenly = before
            for values in (self._proved, self._predicted, self._steps, self._covariance):
                del values[first - 1 :]
            for j, each in enumerate(run, start=first):
                self._add(j, each._replace(late=each.measured))
            self.fits += 1
        elif len(run) < LATEST:
            return
        self._apart = None

    def _add(self, k: int, predicted: Prediction) -> None:
        """Register a node, and put all that is known of its step together."""
        found = self._provenly.add(self._nodes.scans[k], predicted)
        between = self._nodes.updates[k] - self._nodes.updates[k - 1] - 1
        self._predicted.append(predicted)
        self._proved.append(found)
        step, covariance = _fuse(found, predicted, between)
        self._steps.append(step)
        self._covariance.append(covariance)


def _made_up(run: list[Prediction]) -> bool:
    """Whether the odometry agrees with the filter over these steps together, though not in the first."""
    spread = np.sqrt(np.square([each.spread for each in run]).sum(axis=0))
    driven, filtered = np.array([(each.step, each.filtered) for each in run]).transpose(1, 0, 2)
    lacked = np.abs(se2.between(driven[0], filtered[0]) / spread).max()
    left = np.abs(se2.between(se2.accumulate(driven)[-1], se2.accumulate(filtered)[-1]) / spread).max()
    return bool(left < min(AGREEING, MADE_UP * lacked))


def _same(before: list[Prediction], after: list[Prediction]) -> bool:
    """Whether two corrections of the odometry come to about the same."""
    old, new = np.array([step.spread for step in before]), np.array([step.spread for step in after])
    off = np.array([se2.between(a.step, b.step) for a, b in zip(before, after, strict=True)])
    ratio = new / old
    return bool(
        (np.abs(off) < SAME_STEP * old).all() and (ratio < SAME_SPREAD).all() and (ratio > 1 / SAME_SPREAD).all()
    )


def _deviations(information: Array) -> Array:
    """The standard deviations [3] of a step of this information [3, 3]."""
    return np.asarray(np.sqrt(np.diagonal(np.linalg.inv(information + LEAST_INFORMATION * np.eye(3)))))


def _fuse(found: RegisteredStep, predicted: Prediction, between: int) -> tuple[Array, Array]:
    """Registration, odometry and the filter's step together, weighted by their information: [3], covariance [3, 3].

    Between two nodes of a dense recording the filter has registered the key scans between them, too: its step knows as
    many times what one registration does. Where it contradicts the registration, it may have closed a loop.
    """
    off = se2.between(found.step, predicted.step)
    # where the registration overruled the odometry this says nothing
    spread = np.hypot(predicted.spread, _deviations(found.information))
    weights = np.where(found.by_filter | (np.abs(off) >= AGREEING * spread), 0.0, 1 / np.square(predicted.spread))
    covariance = np.linalg.inv(found.information + np.diag(weights) + LEAST_INFORMATION * np.eye(3))
    step = se2.compose(found.step, covariance @ (weights * off))
    off = se2.between(step, predicted.filtered)
    agree = off @ np.linalg.inv(covariance + FLOOR) @ off < AGREEING**2
    excess = agree * between * found.information
    covariance = np.linalg.inv(np.linalg.inv(covariance) + excess)
    step = se2.compose(step, covariance @ excess @ off)
    return step, covariance + FLOOR + np.outer(found.doubt, found.doubt)
