"""A drive: a driver, the robot's body and the actors in one physics engine, and what truly came of it."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from moteslam.robot import se2
from moteslam.robot.se2 import Array
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised
from moteslam.sim.actors.actors import TRUTH_RATE, Actors, Tracks
from moteslam.sim.robot.driver import PATIENCE, Driver, Limits, pace
from moteslam.sim.robot.mishaps import Carried, Mishap, carrying
from moteslam.sim.robot.vehicle import PHYSICS_RATE, Vehicle

CONTROL_STEPS = 8  # Physics steps between two commands of the driver (50 Hz)
STUCK_AFTER = 5.0  # A driver that asks for motion and gets under 5 cm and 0.05 rad of it in this time gives up [s]


@dataclass(frozen=True, eq=False, repr=False)
class Drive(Summarised):
    """What the robot truly did, at 400 Hz."""

    stamps: Array  # [n] [s], from 0 unless it is a part
    poses: Array  # [n, 3] true poses in the world, the heading not wrapped
    velocities: Array  # [n, 3] true velocity in the world [m/s, m/s] and yaw rate [rad/s]
    wheel_travel: Array  # [n, 4] how far the rims of the FR, FL, RR, RL wheel have turned since the start [m]
    end: str  # why it ended: arrived, stuck or out of time
    tracks: Tracks | None = None  # of people and doors; None without any

    @property
    def truth(self) -> Trajectory:
        """The true trajectory, headings wrapped."""
        poses = self.poses.copy()
        poses[:, 2] = se2.wrap(poses[:, 2])
        return Trajectory(self.stamps, poses)


def drive(
    run: Run, driver: Driver, limits: Limits, duration: float, *, progress: Callable[[float], None] = lambda _: None
) -> Drive:
    """Rest, drive for at most so long [s] until the driver has arrived, is stuck or out of time, and rest again.

    Each `Mishap` of the run happens to the robot; ``progress`` is called with the share of the path that lies behind.
    """
    vehicle, actors, dt, interval = run.vehicle, run.actors, 1 / PHYSICS_RATE, CONTROL_STEPS / PHYSICS_RATE
    run.driver = driver
    waited = 0.0
    end, end_step = "out of time", round((duration - limits.rest_end) * PHYSICS_RATE)
    rest_steps, stuck_steps = round(limits.rest_start * PHYSICS_RATE), round(STUCK_AFTER * PHYSICS_RATE)
    stuck_check, stuck_pose, carried = rest_steps + stuck_steps, run.state, 0
    for step in range(end_step):
        mishap = run.mishap
        if mishap is not None:
            stuck_check, stuck_pose = max(step, rest_steps) + stuck_steps, run.state
        if isinstance(mishap, Carried):
            run.step()
            carried += step >= rest_steps
            continue
        if step >= rest_steps and step % CONTROL_STEPS == 0:
            x, y, theta = run.state[:3]
            wanted = driver.command((step - rest_steps - carried) * dt, x, y, theta)
            if wanted is None:
                end = "arrived"
                break
            if actors is not None and driver.looks:
                share = pace((x, y, theta), vehicle.platform, *actors.obstacles())
                wanted = (wanted[0] * share, wanted[1] * share)
                waited = waited + interval if share < 0.1 else 0.0
                if 0.0 < waited < PATIENCE:
                    stuck_check, stuck_pose = step + stuck_steps, run.state
            run.ask(*wanted, limits, interval)
            if step >= stuck_check and driver.looks:
                moved = math.hypot(x - stuck_pose[0], y - stuck_pose[1])
                if moved < 0.05 and abs(theta - stuck_pose[2]) < 0.05:
                    end = "stuck"
                    break
                stuck_check, stuck_pose = step + stuck_steps, run.state
            if step % PHYSICS_RATE == 0:
                progress(driver.done)
        run.step()
    for _ in range(max(1, round(limits.rest_end * PHYSICS_RATE))):
        run.ask(0.0, 0.0, limits, 2 * dt)
        run.step()
    return run.driven(end)


class Run:
    """Vehicle and actors step by step.

    Attributes:
        speed, turn_rate: what the motors are asked for [m/s], [rad/s].
        driver: on whose path it is carried; None for one without a path.
    """

    def __init__(self, vehicle: Vehicle, actors: Actors | None, faults: Sequence[object] = ()) -> None:
        """What happens to the robot (see `Mishap`) is taken from a scenario's faults, one at a time."""
        self.vehicle, self.actors = vehicle, actors
        self.driver: Driver | None = None
        self._mishaps: dict[range, tuple[Mishap, str]] = {}  # by their steps
        for i, fault in enumerate(faults):
            if isinstance(fault, Mishap):
                first = round(fault.start * PHYSICS_RATE)
                steps = range(first, first + max(1, round(fault.duration * PHYSICS_RATE)))
                self._mishaps[steps] = (fault, f"faults.{i}")
        self.state = vehicle.state()  # the vehicle's present one, see ``Vehicle.state``
        self.steps = 0  # of the physics so far
        self.speed = self.turn_rate = 0.0
        self._states = array("d", self.state)  # a fifth of the memory of tuples: two hours are 3 million states
        if actors is not None:
            actors.record()

    def ask(self, speed: float, turn_rate: float, limits: Limits, seconds: float) -> None:
        """Ask the motors for a speed [m/s] and turn rate [rad/s], as far as they may change in this time [s]."""
        self.speed = _approach(self.speed, speed, limits.acceleration * seconds)
        self.turn_rate = _approach(self.turn_rate, turn_rate, limits.turn_acceleration * seconds)

    @property
    def mishap(self) -> Mishap | None:
        """What happens to the robot in the next physics step."""
        return next((fault for steps, (fault, _) in self._mishaps.items() if self.steps in steps), None)

    def step(self) -> None:
        """One physics step; the driver goes on from where the robot is set down that was carried."""
        vehicle, steps = self.vehicle, next((steps for steps in self._mishaps if self.steps in steps), None)
        if steps is None:
            vehicle.push(self.speed, self.turn_rate)
            self._advance()
            return
        fault, field = self._mishaps[steps]
        if not isinstance(fault, Carried):  # the wheels spin as asked while the robot stands
            x, y, theta = self.state[:3]
            vehicle.spin(self.speed, self.turn_rate)
            self._advance((x, y, theta))
            return
        index, count = self.steps - steps.start, len(steps)
        if index == 0:
            pose = np.array(self.state[:3])
            self._carried, self._goal = carrying(fault, pose, self.driver, PHYSICS_RATE, field=field)
            vehicle.lift(up=True)
        here, following = self._carried[index], self._carried[min(index + 1, count - 1)]
        vehicle.spin(0.0, 0.0)
        (x, y, theta), (vx, vy, turn) = here.tolist(), ((following - here) * PHYSICS_RATE).tolist()
        self._advance((x, y, theta), (vx, vy, turn))
        self.speed = self.turn_rate = 0.0
        if index == count - 1:
            vehicle.lift(up=False)
            if self.driver is not None:
                self.driver.at = self._goal

    def _advance(
        self, pose: tuple[float, float, float] | None = None, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        """One physics step of all; with a pose the robot is there after it."""
        vehicle, actors, done, dt = self.vehicle, self.actors, self.steps, 1 / PHYSICS_RATE
        if actors is not None and done % CONTROL_STEPS == 0:
            actors.move(done * dt, CONTROL_STEPS * dt, (self.state[0], self.state[1]), vehicle.platform.radius)
        vehicle.space.step(dt)
        if pose is not None:
            vehicle.put(pose, velocity)
        self.state = vehicle.state()
        self._states.extend(self.state)
        self.steps += 1
        if actors is not None and (done + 1) % (PHYSICS_RATE // TRUTH_RATE) == 0:
            actors.record()

    def driven(self, end: str = "", seconds: float | None = None) -> Drive:
        """What came of it so far, or its latest part of so many seconds."""
        first = 0 if seconds is None else max(0, self.steps + 1 - round(seconds * PHYSICS_RATE))
        table = np.frombuffer(self._states, np.float64).reshape(self.steps + 1, -1)[first:].copy()
        stamps = np.arange(first, self.steps + 1, dtype=np.float64) / PHYSICS_RATE
        tracks = self.actors.tracks(seconds) if self.actors is not None and self.steps else None
        return Drive(stamps, table[:, :3], table[:, 3:6], table[:, 6:], end, tracks)


def _approach(value: float, wanted: float, change: float) -> float:
    return min(max(wanted, value - change), value + change)
