"""The robot as a body in a physics engine, pushed by its wheels; where it goes is what the engine says.

Contact of a wheel with the floor: a force against the slip between rim and floor, proportional to it until the grip
gives way (Probabilistic Robotics has no such model; this is the usual linear tyre with a friction circle). A
skid-steered robot slips sideways in every turn. With a sideways stiffness k_y and a lengthwise k_x, base B and track
T, four wheels turn on the spot as if their track were T + (k_y / k_x) B^2 / T: so k_y / k_x follows from the
platform's effective track.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from moteslam.robot import se2
from moteslam.robot.trajectory import Trajectory
from moteslam.sim.cast import PATIENCE, Cast
from moteslam.sim.driving import sideways_ratio
from moteslam.sim.movers import Movers
from moteslam.sim.pursuit import BlindDriver, Driver, PathDriver
from moteslam.sim.rates import PHYSICS_RATE, TRUTH_RATE
from moteslam.sim.scenario import Scenario
from moteslam.sim.walkers import ROBOT
from moteslam.sim.wander import wander_path
from moteslam.sim.world import World

CONTROL_STEPS = 8
"""Physics steps between two looks of the driver (50 Hz)."""
STUCK_AFTER = 5.0
"""A driver that asks for motion and gets under 5 cm and 0.05 rad of it in so many seconds gives up [s]."""
GRAVITY = 9.80665


@dataclass(frozen=True, eq=False)
class Drive:
    """What the robot truly did, at 400 Hz.

    Attributes:
        stamps: [n] [s], from 0.
        poses: [n, 3] true poses in the world, the heading not wrapped.
        velocities: [n, 3] true velocity in the world [m/s, m/s] and yaw rate [rad/s].
        wheel_travel: [n, 4] how far the rims of the FR, FL, RR, RL wheel have turned since the start [m].
        end: why it ended: ``arrived``, ``stuck`` or ``out of time``.
        movers: where people and doors were; None where there are none.
    """

    stamps: NDArray[np.float64]
    poses: NDArray[np.float64]
    velocities: NDArray[np.float64]
    wheel_travel: NDArray[np.float64]
    end: str
    movers: Movers | None = None

    @property
    def truth(self) -> Trajectory:
        """The true trajectory, headings wrapped."""
        poses = self.poses.copy()
        poses[:, 2] = se2.wrap(poses[:, 2])
        return Trajectory(self.stamps, poses)


def drive(
    scenario: Scenario,
    world: World,
    rng: np.random.Generator,
    *,
    others: np.random.Generator | None = None,
    progress: Callable[[float], None] | None = None,
) -> Drive:
    """Let the robot drive its scenario: rest, drive until its driver has arrived, is stuck or out of time, rest.

    Args:
        scenario: what to do and the robot's body.
        world: what to do it in.
        rng: of the driver's inattention and, for a wander, of its route.
        others: of the people and doors; seed 0 where there is none.
        progress: told the share of the way that lies behind.
    """
    engine = _Engine(scenario, world, np.random.default_rng(0) if others is None else others)
    cast, waited = engine.cast, 0.0
    driver = _driver(scenario, world, rng)
    limits, dt = scenario.drive, 1 / PHYSICS_RATE
    speed = turn_rate = 0.0
    end, end_step = "out of time", round((scenario.duration - limits.rest_end) * PHYSICS_RATE)
    rest_steps = round(limits.rest_start * PHYSICS_RATE)
    rows = [engine.state()]
    stuck_check = rest_steps + round(STUCK_AFTER * PHYSICS_RATE)
    stuck_pose = engine.state()
    for step in range(end_step):
        if step >= rest_steps and step % CONTROL_STEPS == 0:
            x, y, theta = rows[-1][:3]
            wanted = driver.command((step - rest_steps) * dt, x, y, theta)
            if wanted is None:
                end = "arrived"
                break
            interval = CONTROL_STEPS * dt
            if cast is not None and scenario.commands is None:
                pace = cast.pace(x, y, theta)
                wanted = (wanted[0] * pace, wanted[1] * pace)
                waited = waited + interval if pace < 0.1 else 0.0
                if 0.0 < waited < PATIENCE:
                    stuck_check, stuck_pose = step + round(STUCK_AFTER * PHYSICS_RATE), rows[-1]
            speed = _approach(speed, wanted[0], limits.acceleration * interval)
            turn_rate = _approach(turn_rate, wanted[1], limits.turn_acceleration * interval)
            if step >= stuck_check and scenario.commands is None:
                moved = math.hypot(x - stuck_pose[0], y - stuck_pose[1])
                if moved < 0.05 and abs(theta - stuck_pose[2]) < 0.05:
                    end = "stuck"
                    break
                stuck_check, stuck_pose = step + round(STUCK_AFTER * PHYSICS_RATE), rows[-1]
            if progress is not None and step % PHYSICS_RATE == 0:
                progress(driver.done)
        engine.step(speed, turn_rate)
        rows.append(engine.state())
    for _ in range(max(1, round(limits.rest_end * PHYSICS_RATE))):
        speed = _approach(speed, 0.0, 2 * limits.acceleration * dt)
        turn_rate = _approach(turn_rate, 0.0, 2 * limits.turn_acceleration * dt)
        engine.step(speed, turn_rate)
        rows.append(engine.state())
    table = np.array(rows)
    stamps = np.arange(len(table), dtype=np.float64) / PHYSICS_RATE
    movers = None if cast is None else cast.movers()
    return Drive(stamps, table[:, :3], table[:, 3:6], table[:, 6:], end, movers)


def _driver(scenario: Scenario, world: World, rng: np.random.Generator) -> Driver:
    if scenario.commands is not None:
        return BlindDriver(scenario.commands)
    if scenario.route is not None:
        return PathDriver(scenario.route.path(), scenario.drive, rng)
    assert scenario.wander is not None
    return PathDriver(wander_path(scenario.wander, world, rng), scenario.drive, rng)


def _approach(value: float, wanted: float, change: float) -> float:
    return min(max(wanted, value - change), value + change)


class _Engine:
    """The pymunk space with its walls, and the robot's body on four wheels."""

    def __init__(self, scenario: Scenario, world: World, others: np.random.Generator) -> None:
        import pymunk

        platform, self._body_settings = scenario.platform, scenario.body
        wheels, settings = platform.wheels, scenario.body
        assert wheels is not None
        space = pymunk.Space()
        space.iterations = 20
        for x0, y0, x1, y1 in world.segments.tolist():
            wall = pymunk.Segment(space.static_body, (x0, y0), (x1, y1), 0.0)
            wall.friction = settings.wall_friction
            space.add(wall)
        inertia = settings.mass * (platform.length**2 + platform.width**2) / 12
        body = pymunk.Body(settings.mass, inertia)
        x, y, theta = scenario.start.tolist()
        body.position, body.angle = (x, y), theta
        hull = pymunk.Poly.create_box(body, (platform.length, platform.width))
        hull.friction = settings.wall_friction
        space.add(body, hull)
        self._space, self._body = space, body
        self._steps = 0
        self._slippery = scenario.world.slippery
        self.cast: Cast | None = None
        if scenario.people or scenario.crowd is not None or scenario.doors:
            hull.filter = pymunk.ShapeFilter(categories=ROBOT)
            self.cast = Cast(scenario, world, space, others)
            self.cast.record()
        base, track = wheels.wheel_base / 2, wheels.track / 2
        self._places = ((base, -track), (base, track), (-base, -track), (-base, track))  # FR, FL, RR, RL
        self._lengthwise = settings.stiffness
        self._sideways = settings.stiffness * sideways_ratio(wheels)
        self._half_track = wheels.effective_track / 2
        self._grip = settings.grip * settings.mass * GRAVITY / 4
        self._rims = [0.0, 0.0, 0.0, 0.0]
        self._travel = [0.0, 0.0, 0.0, 0.0]

    def state(self) -> tuple[float, ...]:
        """x, y, theta, their velocities, and the travel of the four wheels."""
        body = self._body
        return (*body.position, body.angle, *body.velocity, body.angular_velocity, *self._travel)

    def step(self, speed: float, turn_rate: float) -> None:
        """One physics step with the motors asked for a speed [m/s] and turn rate [rad/s]."""
        body, dt = self._body, 1 / PHYSICS_RATE
        settings = self._body_settings
        cos, sin = math.cos(body.angle), math.sin(body.angle)
        vx, vy = body.velocity
        yaw_rate = body.angular_velocity
        forward, left = cos * vx + sin * vy, cos * vy - sin * vx
        total_x = total_y = moment = 0.0
        for i, (px, py) in enumerate(self._places):
            rim = self._rims[i]
            # the floor's force on the wheel, against the slip at its contact
            fx = self._lengthwise * (rim - (forward - yaw_rate * py))
            fy = -self._sideways * (left + yaw_rate * px)
            size = math.hypot(fx, fy)
            grip = self._grip
            if self._slippery:
                grip *= self._grip_share(body.position.x + cos * px - sin * py, body.position.y + sin * px + cos * py)
            if size > grip:
                fx, fy = fx * grip / size, fy * grip / size
            total_x, total_y, moment = total_x + fx, total_y + fy, moment + px * fy - py * fx
            # a motor that reaches its speed at once if its bounded force can
            wanted = speed + math.copysign(self._half_track, py) * -turn_rate
            push = (wanted - rim) * settings.wheel_mass / dt + fx
            push = min(max(push, -settings.wheel_force), settings.wheel_force)
            self._rims[i] = rim = rim + (push - fx) * dt / settings.wheel_mass
            self._travel[i] += rim * dt
        body.force = (cos * total_x - sin * total_y, sin * total_x + cos * total_y)
        body.torque = moment
        cast, steps = self.cast, self._steps
        if cast is not None and steps % CONTROL_STEPS == 0:
            cast.move(steps * dt, CONTROL_STEPS * dt, (body.position.x, body.position.y))
        self._space.step(dt)
        self._steps += 1
        if cast is not None and self._steps % (PHYSICS_RATE // TRUTH_RATE) == 0:
            cast.record()

    def _grip_share(self, x: float, y: float) -> float:
        """How the grip at a place compares with that of the floor: the least of the patches there."""
        share = 1.0
        for patch in self._slippery:
            (left, low), (wide, high) = patch.corner, patch.size
            if left <= x <= left + wide and low <= y <= low + high:
                share = min(share, patch.grip / self._body_settings.grip)
        return share
