"""The robot as a body in a physics engine, pushed by its wheels.

Contact of a wheel with the floor: a force against the slip between rim and floor, proportional to it until the grip
gives way (Probabilistic Robotics has no such model; this is the usual linear tyre with a friction circle). A
skid-steered robot slips sideways in every turn. With a sideways stiffness k_y and a lengthwise k_x, base B and track
T, four wheels turn on the spot as if their track were T + (k_y / k_x) B^2 / T: so k_y / k_x follows from the
platform's effective track. Two wheels on one axle, with a caster that only carries, hold sideways as lengthwise and
turn as their effective track says.
"""

import math

from moteslam.errors import ConfigError
from moteslam.robot.noise import DriveNoise
from moteslam.robot.platform import Body, Platform, Wheels
from moteslam.robot.se2 import Array
from moteslam.sim.actors.people import ROBOT
from moteslam.sim.world.world import World

PHYSICS_RATE = 400  # Physics steps a second [Hz]
GRAVITY = 9.80665  # [m/s^2]
SHIFTS = 0.02  # Time in which the load shifts between the wheels [s]


class Vehicle:
    """The robot's body on its wheels, among the walls of a physics engine's ``space``; others may be put into it.

    It starts at a pose [3]. Of the world it feels the slippery patches, too, of the noise rolling resistance, and the
    height of the mass, by which the load shifts between the wheels.
    """

    def __init__(self, platform: Platform, start: Array, world: World, noise: DriveNoise) -> None:
        import pymunk

        wheels, body = platform.wheels, platform.body
        assert wheels is not None  # a scenario without wheels or body is refused
        assert body is not None
        self.platform, self._settings, self._slippery = platform, body, world.slippery
        self.space = pymunk.Space()
        self.space.iterations = 20
        for x0, y0, x1, y1 in world.segments.tolist():
            wall = pymunk.Segment(self.space.static_body, (x0, y0), (x1, y1), 0.0)
            wall.friction = body.wall_friction
            self.space.add(wall)
        self._body = pymunk.Body(body.mass, _inertia(body, platform))
        x, y, theta = start.tolist()
        self._body.position, self._body.angle = (x, y), theta
        self._hull = hull = pymunk.Poly.create_box(self._body, (platform.length, platform.width))
        hull.friction = body.wall_friction
        hull.filter = pymunk.ShapeFilter(categories=ROBOT)
        self.space.add(self._body, hull)
        self._places = _places(wheels)
        self._sideways = body.stiffness * wheels.sideways_ratio
        self._half_track = wheels.effective_track / 2
        self._grip = body.grip * body.mass * GRAVITY / len(self._places)
        self._noise = noise
        self._loads = [1.0] * len(self._places)
        self._rims = [0.0] * len(self._places)
        self._travel = [0.0] * len(self._places)

    def state(self) -> tuple[float, ...]:
        """x, y, theta, their velocities, and the travel of the FR, FL, RR, RL wheel; of two, each stands twice."""
        body, travel = self._body, self._travel
        return (*body.position, body.angle, *body.velocity, body.angular_velocity, *travel, *travel[: 4 - len(travel)])

    def push(self, speed: float, turn_rate: float) -> None:
        """Set the forces of the next physics step, with the motors asked for a speed [m/s] and turn rate [rad/s]."""
        body, settings, dt = self._body, self._settings, 1 / PHYSICS_RATE
        cos, sin = math.cos(body.angle), math.sin(body.angle)
        vx, vy = body.velocity
        yaw_rate = body.angular_velocity
        forward, left = cos * vx + sin * vy, cos * vy - sin * vx
        total_x = total_y = moment = 0.0
        for i, (px, py) in enumerate(self._places):
            rim, load = self._rims[i], self._loads[i]
            # the floor's force on the wheel, against the slip at its contact
            fx = load * settings.stiffness * (rim - (forward - yaw_rate * py))
            fy = -load * self._sideways * (left + yaw_rate * px)
            size = math.hypot(fx, fy)
            grip = load * self._grip
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
        if self._noise.mass_height > 0:
            self._shift_load(total_x / settings.mass, total_y / settings.mass)
        # constant, and in proportion below 1 cm/s so that nothing rolls back
        share = min(max(forward / 0.01, -1.0), 1.0)
        total_x -= share * self._noise.rolling_resistance * settings.mass * GRAVITY
        body.force = (cos * total_x - sin * total_y, sin * total_x + cos * total_y)
        body.torque = moment

    def spin(self, speed: float, turn_rate: float) -> None:
        """Turn the wheels for a physics step as asked, a speed [m/s] and turn rate [rad/s], whatever the body does."""
        for i, (_, py) in enumerate(self._places):
            self._rims[i] = speed + math.copysign(self._half_track, py) * -turn_rate
            self._travel[i] += self._rims[i] / PHYSICS_RATE

    def put(self, pose: tuple[float, float, float], velocity: tuple[float, float, float]) -> None:
        """Set the pose (x, y [m], heading [rad]) of the body and its velocity, whatever pushes it."""
        body = self._body
        body.position, body.angle = pose[:2], pose[2]
        body.velocity, body.angular_velocity = velocity[:2], velocity[2]
        body.force, body.torque = (0.0, 0.0), 0.0
        self.space.reindex_shapes_for_body(body)

    def lift(self, *, up: bool) -> None:
        """Lift the body off the floor, where it touches nothing, or set it down."""
        import pymunk

        self._hull.filter = pymunk.ShapeFilter(categories=ROBOT, **({"mask": 0} if up else {}))

    def _shift_load(self, forward: float, left: float) -> None:
        """Share the weight between the wheels anew, for accelerations [m/s^2]; in 20 ms, as springs do."""
        height, keep = self._noise.mass_height / GRAVITY, math.exp(-1 / (PHYSICS_RATE * SHIFTS))
        for i, (px, py) in enumerate(self._places):
            shifted = -height * (forward / px if px else 0.0) - height * left / py
            wanted = min(max(1.0 + shifted, 0.0), 2.0)
            self._loads[i] = keep * self._loads[i] + (1 - keep) * wanted

    def _grip_share(self, x: float, y: float) -> float:
        """The grip at a place over that of the floor: the least of the patches there."""
        share = 1.0
        for patch in self._slippery:
            (left, low), (wide, high) = patch.corner, patch.size
            if left <= x <= left + wide and low <= y <= low + high:
                share = min(share, patch.grip / self._settings.grip)
        return share


def check_wheels(platform: Platform) -> None:
    """Refuse a platform without wheels, with a wrong track, or with wheels outside its body."""
    wheels = platform.wheels
    if wheels is None:
        raise ConfigError("none, expected wheels to drive on", field="platform.wheels")
    if wheels.effective_track < wheels.track:
        raise ConfigError(
            f"{wheels.effective_track:g} m, expected at least the track, {wheels.track:g} m",
            field="platform.wheels.effective_track",
        )
    if wheels.wheel_base == 0 and wheels.effective_track > platform.width:
        raise ConfigError(
            f"{wheels.effective_track:g} m, expected two wheels on one axle within the body, {platform.width:g} m",
            field="platform.wheels.effective_track",
        )
    for side, inner, outer in (("length", wheels.wheel_base, platform.length), ("width", wheels.track, platform.width)):
        if inner > outer:
            raise ConfigError(
                f"{outer:g} m, expected the wheels, {inner:g} m apart, within the body", field=f"platform.{side}"
            )


def check_body(platform: Platform) -> None:
    """Refuse a contact so stiff, for masses so small, that a step of the physics overshoots by more than half."""
    wheels, body = platform.wheels, platform.body
    if body is None:
        raise ConfigError("none, expected the robot's masses and forces", field="platform.body")
    assert wheels is not None
    ratio, places = wheels.sideways_ratio, _places(wheels)
    arm = sum(ratio * x**2 + y**2 for x, y in places)
    softest = min(body.wheel_mass, body.mass / len(places) / max(ratio, 1.0), _inertia(body, platform) / arm)
    stiffest = softest * PHYSICS_RATE / 2
    if body.stiffness > stiffest:
        raise ConfigError(
            f"{body.stiffness:g} N s/m, expected at most {stiffest:.3g} for these masses and this effective track",
            field="platform.body.stiffness",
        )


def _inertia(body: Body, platform: Platform) -> float:
    """Of a homogeneous rectangle about its centre [kg m^2]."""
    return body.mass * (platform.length**2 + platform.width**2) / 12


def _places(wheels: Wheels) -> tuple[tuple[float, float], ...]:
    """Where the wheels stand (x, y) in the robot's frame [m]: FR, FL, RR, RL, or right and left of one axle."""
    if wheels.wheel_base == 0:
        return ((0.0, -wheels.effective_track / 2), (0.0, wheels.effective_track / 2))
    base, track = wheels.wheel_base / 2, wheels.track / 2
    return ((base, -track), (base, track), (-base, -track), (-base, track))
