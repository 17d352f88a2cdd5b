"""A drive: a driver, the robot's body and the actors in one physics engine, and what truly came of it."""

from __future__ import annotations

import math
from array import array
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Summarised
from moteslam.sim.actors.actors import TRUTH_RATE, Actors, Tracks
from moteslam.sim.robot.driver import PATIENCE, Driver, Limits, pace
from moteslam.sim.robot.mishaps import Carried, Mishap, carrying
from moteslam.sim.robot.vehicle import PHYSICS_RATE, Vehicle

Array = NDArray[np.float64]

CONTROL_STEPS = 8
"""Physics steps between two commands of the driver (50 Hz)."""
STUCK_AFTER = 5.0
"""A driver that asks for motion and gets under 5 cm and 0.05 rad of it in this time gives up [s]."""


@dataclass(frozen=True, eq=False, repr=False)
class Drive(Summarised):
    """What the robot truly did, at 400 Hz."""

    stamps: Array  # [n] [s], from 0
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
    vehicle: Vehicle,
    driver: Driver,
    limits: Limits,
    duration: float,
    *,
    actors: Actors | None = None,
    faults: Sequence[object] = (),
    progress: Callable[[float], None] = lambda _: None,
) -> Drive:
    """Rest, drive until the driver has arrived, is stuck or out of time, and rest again.

    Args:
        vehicle: the robot's body where it starts, with the actors in its space.
        duration: of the drive at most [s].
        faults: of a scenario; what happens to the robot (see `Mishap`) is taken from them, one at a time.
        progress: called with the share of the path that lies behind.
    """
    run = _Run(vehicle, actors)
    dt, interval = 1 / PHYSICS_RATE, CONTROL_STEPS / PHYSICS_RATE
    speed = turn_rate = waited = 0.0
    end, end_step = "out of time", round((duration - limits.rest_end) * PHYSICS_RATE)
    rest_steps, stuck_steps = round(limits.rest_start * PHYSICS_RATE), round(STUCK_AFTER * PHYSICS_RATE)
    stuck_check, stuck_pose, carried = rest_steps + stuck_steps, run.state, 0
    mishaps = {_steps_of(fault): (fault, f"faults.{i}") for i, fault in enumerate(faults) if isinstance(fault, Mishap)}
    for step in range(end_step):
        held = next((steps for steps in mishaps if step in steps), None)
        if held is not None:
            stuck_check, stuck_pose = max(step, rest_steps) + stuck_steps, run.state
            fault, field = mishaps[held]
        if held is not None and isinstance(fault, Carried):
            run.carry(fault, step - held.start, len(held), driver, field)
            speed = turn_rate = 0.0
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
            speed = _approach(speed, wanted[0], limits.acceleration * interval)
            turn_rate = _approach(turn_rate, wanted[1], limits.turn_acceleration * interval)
            if step >= stuck_check and driver.looks:
                moved = math.hypot(x - stuck_pose[0], y - stuck_pose[1])
                if moved < 0.05 and abs(theta - stuck_pose[2]) < 0.05:
                    end = "stuck"
                    break
                stuck_check, stuck_pose = step + stuck_steps, run.state
            if step % PHYSICS_RATE == 0:
                progress(driver.done)
        if held is not None:
            run.stand(speed, turn_rate)
        else:
            run.step(speed, turn_rate)
    for _ in range(max(1, round(limits.rest_end * PHYSICS_RATE))):
        speed = _approach(speed, 0.0, 2 * limits.acceleration * dt)
        turn_rate = _approach(turn_rate, 0.0, 2 * limits.turn_acceleration * dt)
        run.step(speed, turn_rate)
    table = run.table()
    stamps = np.arange(len(table), dtype=np.float64) / PHYSICS_RATE
    tracks = None if actors is None else actors.tracks()
    return Drive(stamps, table[:, :3], table[:, 3:6], table[:, 6:], end, tracks)


def _steps_of(fault: Mishap) -> range:
    """The physics steps of a mishap."""
    first = round(fault.start * PHYSICS_RATE)
    return range(first, first + max(1, round(fault.duration * PHYSICS_RATE)))


class _Run:
    """Vehicle and actors step by step; ``state`` is the vehicle's present one, ``table`` has all of them."""

    def __init__(self, vehicle: Vehicle, actors: Actors | None) -> None:
        self._vehicle, self._actors = vehicle, actors
        self.state = vehicle.state()
        self._steps = 0
        self._states = array("d", self.state)  # a fifth of the memory of tuples: two hours are 3 million states
        if actors is not None:
            actors.record()

    def step(self, speed: float, turn_rate: float) -> None:
        """One physics step with the motors asked for a speed [m/s] and turn rate [rad/s]."""
        self._vehicle.push(speed, turn_rate)
        self._advance()

    def stand(self, speed: float, turn_rate: float) -> None:
        """One physics step in which the wheels spin as asked while the robot stands."""
        x, y, theta = self.state[:3]
        self._vehicle.spin(speed, turn_rate)
        self._advance((x, y, theta), (0.0, 0.0, 0.0))

    def carry(self, fault: Carried, index: int, count: int, driver: Driver, field: str) -> None:
        """One of ``count`` physics steps of being carried; the driver goes on from where the last of them ends."""
        vehicle = self._vehicle
        if index == 0:
            pose = np.array(self.state[:3])
            self._carried, self._goal = carrying(fault, pose, driver, PHYSICS_RATE, field=field)
            vehicle.lift(up=True)
        here, following = self._carried[index], self._carried[min(index + 1, count - 1)]
        vehicle.spin(0.0, 0.0)
        (x, y, theta), (vx, vy, turn) = here.tolist(), ((following - here) * PHYSICS_RATE).tolist()
        self._advance((x, y, theta), (vx, vy, turn))
        if index == count - 1:
            vehicle.lift(up=False)
            driver.at = self._goal

    def _advance(
        self, pose: tuple[float, float, float] | None = None, velocity: tuple[float, float, float] = (0.0, 0.0, 0.0)
    ) -> None:
        """One physics step of all; with a pose the robot is there after it."""
        vehicle, actors, done, dt = self._vehicle, self._actors, self._steps, 1 / PHYSICS_RATE
        if actors is not None and done % CONTROL_STEPS == 0:
            actors.move(done * dt, CONTROL_STEPS * dt, vehicle.position, vehicle.platform.radius)
        vehicle.space.step(dt)
        if pose is not None:
            vehicle.put(pose, velocity)
        self.state = vehicle.state()
        self._states.extend(self.state)
        self._steps += 1
        if actors is not None and (done + 1) % (PHYSICS_RATE // TRUTH_RATE) == 0:
            actors.record()

    def table(self) -> Array:
        """The states [n, 10] at 400 Hz, as `Vehicle.state` gives each."""
        return np.array(self._states).reshape(self._steps + 1, -1)


def _approach(value: float, wanted: float, change: float) -> float:
    return min(max(wanted, value - change), value + change)
