"""The configuration of a SLAM run: frozen, unknown keys refused, named presets in TOML.

Where the values come from: ``settings``.
"""

from __future__ import annotations

import math
from itertools import pairwise
from typing import Annotated, Literal

import tomli_w
from pydantic import BaseModel, ConfigDict, Field, FiniteFloat, field_validator, model_validator

NotNegative = Annotated[FiniteFloat, Field(ge=0)]
Positive = Annotated[FiniteFloat, Field(gt=0)]
Offsets = Annotated[tuple[FiniteFloat, ...], Field(min_length=1, max_length=41)]


class _Section(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)


class SyncConfig(_Section):
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
    deskew: bool = True


class MotionNoise(_Section):
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


class SearchConfig(_Section):
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


class UpdateConfig(_Section):
    """Which scans the filter works on; the poses of those between follow the odometry.

    A scan is worked on when the robot has moved this far, or turned this much, since the last that was, or when this
    time has passed.

    Attributes:
        distance: [m]; rotation: [rad]; interval: [s].
    """

    distance: NotNegative = 0.0
    rotation: NotNegative = 0.0
    interval: Positive = 1e9


class MapConfig(_Section):
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

    cell_size: Annotated[FiniteFloat, Field(ge=0.005, le=1.0)] = 0.05
    hit_probability: Annotated[FiniteFloat, Field(gt=0.5, lt=1)] = 0.8
    limit: Annotated[FiniteFloat, Field(gt=0, le=64)] = 50.0
    occupied_threshold: FiniteFloat = 0.0
    count: Literal["scan", "ray"] = "scan"
    guard_cells: Annotated[int, Field(ge=0, le=16)] = 1

    @property
    def log_odds_step(self) -> float:
        """The change of a cell [log-odds]: log(p / (1 - p))."""
        return math.log(self.hit_probability / (1 - self.hit_probability))


class TextureConfig(_Section):
    """The coloured map of the floor (section III.E), made of a recording that has camera images.

    Attributes:
        enabled: make one where there are images.
        cell_size: [m].
        height_limit: points at or above it are not floor [m]; the paper's 0.1.
        max_depth: points deeper than this are left out [m]: the error of a depth grows with its square.
        interval: shortest time between two frames that are used [s]; 0 uses all.
        largest_gap: between the colour and the disparity image of a frame [s].
    """

    enabled: bool = True
    cell_size: Annotated[FiniteFloat, Field(ge=0.005, le=1.0)] = 0.05
    height_limit: FiniteFloat = 0.1
    max_depth: Annotated[FiniteFloat, Field(gt=0, le=100)] = 8.0
    interval: NotNegative = 0.1
    largest_gap: NotNegative = 0.05


class SurfaceConfig(_Section):
    """The signed-distance map that each particle of the method ``surface`` has.

    Attributes:
        cell_size: of the fine level; the coarse level's are twice as large [m].
        truncation, coarse_truncation: how far from a surface cells know their distance to it, on each level [m].
        sharp: distances below it weigh ``sharp_weight`` times as much in a cell's average as those beyond [m]: near
            corners and thin walls a cell is near to two surfaces, and the nearer one must tell.
        sharp_weight: see ``sharp``.
        max_weight: a cell's average weighs at most this against the next observation.
        spacing: endpoints nearer than this to each other are averaged to one vertex [m].
        gap, gap_from_range: a surface is drawn between neighbouring endpoints up to ``gap + gap_from_range * range``
            apart [m], [m/m] ...
        straight_gap: ... and up to so many times that where four endpoints in a row lie on a straight line,
        straightness: to within this [m]: a wall seen at a grazing angle.
    """

    cell_size: Annotated[FiniteFloat, Field(ge=0.01, le=1.0)] = 0.08
    truncation: Positive = 0.16
    coarse_truncation: Positive = 0.4
    sharp: Positive = 0.06
    sharp_weight: Annotated[int, Field(ge=1, le=31)] = 8
    max_weight: Annotated[int, Field(ge=1, le=31)] = 31
    spacing: Positive = 0.02
    gap: Positive = 0.3
    gap_from_range: NotNegative = 0.03
    straight_gap: Annotated[FiniteFloat, Field(ge=1)] = 1.0
    straightness: Positive = 0.03


class RegistrationConfig(_Section):
    """How scans are registered to the particles' maps (method ``surface``): Gauss-Newton from coarse to fine.

    Attributes:
        residual: standard deviation of an endpoint's distance to the surface [m].
        translation, translation_from_translation: standard deviation of the odometry [m], [m/m] ...
        rotation, rotation_from_rotation: ... [rad], [rad/rad]: a loose prior, since what it is off by is systematic.
        guess_translation, guess_rotation: standard deviation of a step's motion that is guessed for want of odometry,
            beside that of odometry [m], [rad].
        prior_weight: how many independent endpoints the odometry weighs as much as: neighbouring ones err alike.
        iterations: at most, on each level.
        sure_above: a scan whose endpoints are at least so likely in the mean, 0 to 1, where registration finds it from
            the odometry's place, is not looked for elsewhere.
        doubtful_below: one whose endpoints are less likely than this in the mean is looked for again, harder.
        lost_below: one of which what matches, less what contradicts the map, is a smaller share of its endpoints is
            lost: it is looked for in a window ...
        wide_distance, wide_rotation: ... of so much to each side [m], [rad] ...
        clear_gain: ... and taken to be there if that share is so much larger.
        patience: scans that are lost in a row are left out of the maps, up to so many.
        degenerate: standard deviation of what is found along the direction that a scan says least of, times the
            share that what it says there is of the most [m]: along two bare walls the odometry is believed instead.
        points: at most so many vertices of a scan are registered to the maps of all particles, evenly chosen.
    """

    residual: Positive = 0.01
    translation: Positive = 0.01
    translation_from_translation: NotNegative = 0.07
    rotation: Positive = 0.01
    rotation_from_rotation: NotNegative = 0.2
    guess_translation: NotNegative = 0.05
    guess_rotation: NotNegative = 0.05
    prior_weight: Positive = 5.0
    iterations: Annotated[int, Field(ge=1, le=100)] = 8
    sure_above: NotNegative = 0.75
    doubtful_below: NotNegative = 0.6
    lost_below: FiniteFloat = 0.04
    wide_distance: NotNegative = 1.5
    wide_rotation: NotNegative = 1.4
    clear_gain: NotNegative = 0.3
    patience: Annotated[int, Field(ge=0)] = 3
    points: Annotated[int, Field(ge=8, le=100_000)] = 1000
    degenerate: NotNegative = 0.0005


class CalibrationConfig(_Section):
    """How the systematic errors of the odometry are learned while driving (method ``surface``).

    Attributes:
        enabled: learn them.
        scale: standard deviation of what the way, and the turns, are off by before anything is known [m/m], [rad/rad].
        curvature: likewise, of how much a straight way bends [rad/m].
        lever: likewise, of how far the lidar is ahead of where the recording says, from the wheels' axle [m].
        change: standard deviation by which these gains change over a metre [1/sqrt(m)].
        translation, translation_from_translation: standard deviation of what one motion is off by beside [m], [m/m].
        rotation, rotation_from_rotation: likewise [rad], [rad/rad].
        gate: motions that are off by more standard deviations teach nothing: wheels slipped.
    """

    enabled: bool = True
    scale: Positive = 0.05
    curvature: Positive = 0.02
    lever: Positive = 0.1
    change: NotNegative = 0.001
    translation: Positive = 0.005
    translation_from_translation: NotNegative = 0.03
    rotation: Positive = 0.01
    rotation_from_rotation: NotNegative = 0.1
    gate: Positive = 3.0


class ProposalConfig(_Section):
    """How the particles of the method ``surface`` spread around what registration found, and are weighed.

    Attributes:
        information_share: share of the endpoints' information that counts: their errors are not independent.
        translation, translation_from_translation, rotation, rotation_from_rotation: standard deviation of the
            odometry where the endpoints say nothing [m], [m/m], [rad], [rad/rad].
        evidence_share: share of the endpoints' log-likelihood that counts in the weights, for the same reason.
        explore: every other particle starts its registration at a place drawn from the odometry's prior.
        unknown: log-likelihood lost for an endpoint where the map knows nothing.
        outlier: log-likelihood lost at most for an endpoint.
        crossing: log-likelihood lost for a ray through a surface of the map.
    """

    information_share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 1.0
    translation: NotNegative = 0.001
    translation_from_translation: NotNegative = 0.02
    rotation: NotNegative = 0.0005
    rotation_from_rotation: NotNegative = 0.02
    evidence_share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.03
    explore: bool = False
    unknown: NotNegative = 2.0
    outlier: NotNegative = 8.0
    crossing: NotNegative = 1.0


class ColourConfig(_Section):
    """The colours of the floor as a measurement in the weights of the method ``surface``.

    Attributes:
        enabled: use them where there are images.
        cell_size: of the maps of the floor [m].
        max_depth: floor deeper than this is left out [m].
        largest_age: of a frame when the scan is taken [s].
        map_length: way after which a new map of the floor is begun [m]; each is compared with for as long again.
        reach: how far to each side of where the lidar puts the robot its floor is looked for [m].
        least_known: share of the cells of a frame that must lie on known floor to be compared.
        spread: mean of a cell's difference that is no surprise, red, green and blue together [levels].
        share: share of the cells' log-likelihood that counts: their errors are not independent.
        spread_translation: standard deviation of what the floor can tell at best [m].
    """

    enabled: bool = False
    cell_size: Annotated[FiniteFloat, Field(ge=0.01, le=0.5)] = 0.04
    max_depth: Annotated[FiniteFloat, Field(ge=0.5, le=8)] = 3.0
    largest_age: NotNegative = 0.25
    map_length: Annotated[FiniteFloat, Field(ge=0.2, le=20)] = 1.0
    reach: Annotated[FiniteFloat, Field(ge=0.02, le=0.5)] = 0.06
    least_known: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.3
    spread: Positive = 60.0
    share: Annotated[FiniteFloat, Field(gt=0, le=1)] = 0.1
    spread_translation: Positive = 0.002


class KldConfig(_Section):
    """As many particles as the belief takes: KLD sampling (Fox 2003; Probabilistic Robotics, table 8.4).

    The number changes where particles are resampled, and there alone.

    Attributes:
        enabled: adapt it; ``SlamConfig.particles`` is then the largest number, and the first.
        epsilon: Kullback-Leibler distance that is allowed between the particles and the belief, over the bins.
        delta: probability that it is exceeded.
        bin_size, bin_angle: of the bins in x and y [m], and in the heading [rad].
        least: never fewer particles than these; ``particles`` wins if it is smaller.
    """

    enabled: bool = False
    epsilon: Positive = 0.05
    delta: Annotated[FiniteFloat, Field(gt=0, lt=1)] = 0.01
    bin_size: Positive = 0.1
    bin_angle: Positive = 0.05
    least: Annotated[int, Field(ge=1)] = 10


class SlamConfig(_Section):
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
    particles: Annotated[int, Field(ge=1, le=1_000_000)] = 100
    resample_below: Annotated[FiniteFloat, Field(ge=0, le=1)] = 0.5
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
