"""The configuration of a SLAM run: frozen, unknown keys refused, named presets in TOML.

Where the values come from: ``settings``.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

import tomli_w
from pydantic import Field, field_validator, model_validator

from moteslam.robot.section import NotNegative, Number, Positive, Section, Share, Truth, Whole
from moteslam.slam.surface_config import (
    CalibrationConfig,
    ColourConfig,
    ProposalConfig,
    RegistrationConfig,
    SurfaceConfig,
)

Offsets = Annotated[tuple[Number, ...], Field(min_length=1, max_length=41)]


class SyncConfig(Section):
    """How streams with their own clocks become one motion between scans (section III.A of the paper).

    Attributes:
        method: ``nearest`` takes the reading nearest in time, as the paper does; ``interpolate`` the value between
            the two readings around it.
        low_pass_hz: cut-off of the causal low-pass on the yaw rate [Hz]; 0 turns it off.
        kinematics: ``euler`` is equation III.1, ``arc`` the exact arc.
        deskew: turn every beam by how the robot moved since the first of its scan, by the odometry.
    """

    method: Literal["nearest", "interpolate"] = "interpolate"
    low_pass_hz: NotNegative = 0.0
    kinematics: Literal["euler", "arc"] = "arc"
    deskew: Truth = True


class MotionNoise(Section):
    """Standard deviations of the Gaussian noise that prediction adds to the control (epsilon in II.6, III.3).

    The paper's noise is constant in (v, omega): the first two. The others grow with the motion itself, so that logs
    whose stamps say nothing (equal ones, one a second) spread too (alpha 1 to 4 of Probabilistic Robotics, 5.3).

    Attributes:
        velocity: [m/s].
        yaw_rate: [rad/s].
        translation_from_translation: [m/m].
        translation_from_rotation: [m/rad].
        rotation_from_translation: [rad/m].
        rotation_from_rotation: [rad/rad].
    """

    velocity: NotNegative = 0.0
    yaw_rate: NotNegative = 0.0
    translation_from_translation: NotNegative = 0.0
    translation_from_rotation: NotNegative = 0.0
    rotation_from_translation: NotNegative = 0.0
    rotation_from_rotation: NotNegative = 0.0


class SearchConfig(Section):
    """The neighbourhood searched around each particle (section III.D.2): the Cartesian product of the offsets.

    Attributes:
        offsets_xy: in x and in y [m].
        offsets_theta: in the heading [rad].
    """

    offsets_xy: Offsets = (-0.1, -0.05, 0.0, 0.05, 0.1)
    offsets_theta: Offsets = (-0.1, -0.05, 0.0, 0.05, 0.1)

    @field_validator("offsets_xy", "offsets_theta")
    @classmethod
    def _rising_through_zero(cls, offsets: tuple[float, ...]) -> tuple[float, ...]:
        if 0.0 not in offsets or any(a >= b for a, b in pairwise(offsets)):
            raise ValueError("expected rising offsets, zero among them")
        return offsets


class UpdateConfig(Section):
    """Which scans the filter works on; the poses of those between follow the odometry.

    A scan is worked on when the robot has moved this far, or turned this much, since the last that was, or when this
    time has passed.

    Attributes:
        distance: [m]; rotation: [rad]; interval: [s].
    """

    distance: NotNegative = 0.0
    rotation: NotNegative = 0.0
    interval: Positive = 1e9


class MapConfig(Section):
    """The occupancy grid (sections II.A and III.C).

    Attributes:
        cell_size: [m].
        hit_probability: how often the lidar is right; a cell changes by its log-odds, log 4 at 0.8 (III.2).
        limit: log-odds are kept within (-limit, limit).
        occupied_threshold: log-odds above which a cell counts as occupied in the score.
        count: ``scan`` changes a cell at most once a scan, an endpoint going over a passing ray; ``ray`` once for
            every ray that meets it.
        guard_cells: cells this near to an endpoint are not freed by other rays of the same scan (``scan`` only):
            beams that graze a wall pass within a cell of where their neighbours end, and would erase it.
    """

    cell_size: Annotated[Number, Field(ge=0.005, le=1.0)] = 0.05
    hit_probability: Annotated[Number, Field(gt=0.5, lt=1)] = 0.8
    limit: Annotated[Number, Field(gt=0, le=64)] = 50.0
    occupied_threshold: Number = 0.0
    count: Literal["scan", "ray"] = "scan"
    guard_cells: Annotated[Whole, Field(ge=0, le=16)] = 1

    @property
    def log_odds_step(self) -> float:
        """The change of a cell [log-odds]: log(p / (1 - p))."""
        return math.log(self.hit_probability / (1 - self.hit_probability))


class TextureConfig(Section):
    """The coloured map of the floor (section III.E), made of a recording that has camera images.

    Attributes:
        enabled: make one where there are images.
        cell_size: [m].
        height_limit: points at or above it are not floor [m]; the paper's 0.1.
        max_depth: points deeper than this are left out [m]: the error of a depth grows with its square.
        interval: shortest time between two frames that are used [s]; 0 uses all.
        largest_gap: between the colour and the disparity image of a frame [s].
        flat: the floor is flat: what is near it is taken to lie on it, where its ray meets it, and the error of its
            depth no longer matters. The paper takes the depth.
    """

    enabled: Truth = True
    cell_size: Annotated[Number, Field(ge=0.005, le=1.0)] = 0.05
    height_limit: Number = 0.1
    max_depth: Annotated[Number, Field(gt=0, le=100)] = 8.0
    interval: NotNegative = 0.1
    largest_gap: NotNegative = 0.05
    flat: Truth = False


class KldConfig(Section):
    """As many particles as the belief takes: KLD sampling (Fox 2003; Probabilistic Robotics, table 8.4).

    The number changes where particles are resampled, and there alone.

    Attributes:
        enabled: adapt it; ``SlamConfig.particles`` is then the largest number, and the first.
        epsilon: Kullback-Leibler distance that is allowed between the particles and the belief, over the bins.
        delta: probability that it is exceeded.
        bin_size, bin_angle: of the bins in x and y [m], and in the heading [rad].
        least: never fewer particles than these; ``particles`` wins if it is smaller.
    """

    enabled: Truth = False
    epsilon: Positive = 0.05
    delta: Annotated[Number, Field(gt=0, lt=1)] = 0.01
    bin_size: Positive = 0.1
    bin_angle: Positive = 0.05
    least: Annotated[Whole, Field(ge=1)] = 10


class SlamConfig(Section):
    """Everything that a SLAM run can be told.

    Attributes:
        method: which filter.
        particles: how many; the largest number where ``kld`` adapts it.
        resample_below: resample when the effective number falls under this share of the particles (section III.D.3);
            1 resamples after every update.
        resampling: how; ``systematic`` draws one random number, ``stratified`` one for each particle, ``residual``
            copies by the whole part of the expected number and draws the rest.
        max_range: endpoints beyond it are not used [m].
        kld, sync, motion, search, update, map, surface, registration, proposal, texture, colours: the parts.
    """

    method: Literal["paper", "surface"] = "paper"
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] = 100
    resample_below: Share = 0.5
    resampling: Literal["systematic", "stratified", "residual"] = "systematic"
    max_range: Positive = 1000.0
    kld: KldConfig = KldConfig()
    sync: SyncConfig = SyncConfig()
    motion: MotionNoise = MotionNoise()
    search: SearchConfig = SearchConfig()
    update: UpdateConfig = UpdateConfig()
    map: MapConfig = MapConfig()
    surface: SurfaceConfig = SurfaceConfig()
    registration: RegistrationConfig = RegistrationConfig()
    proposal: ProposalConfig = ProposalConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    texture: TextureConfig = TextureConfig()
    colours: ColourConfig = ColourConfig()

    @model_validator(mode="after")
    def _colours_weigh_the_particles_of_surface(self) -> SlamConfig:
        if self.colours.enabled and self.method != "surface":
            raise ValueError('colours.enabled with method "paper", expected method "surface": the only one to use them')
        return self

    def to_toml(self) -> str:
        """The configuration as TOML; it reads back equal."""
        return tomli_w.dumps(self.model_dump(mode="json"))
