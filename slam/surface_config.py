"""The configuration of the method ``surface``: its maps, its registration, its odometry, its proposal, the floor."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field, model_validator

from moteslam.robot.section import NotNegative, Number, Positive, Section, Share, Truth, Whole

LONGEST_REACH = 100
"""Cells of a level that a surface at most reaches to each side."""


class SurfaceConfig(Section):
    """The signed-distance map that each particle of the method ``surface`` has.

    Attributes:
        cell_size: of the fine level; the coarse level's are twice as large [m].
        truncation, coarse_truncation: how far from a surface cells know their distance to it, on each level [m].
        coarse_chord: on the coarse level segments are joined until their chord is this long [coarse cells].
        sharp: distances below it weigh ``sharp_weight`` times as much in a cell's average as those beyond [m]: near
            corners and thin walls a cell is near to two surfaces, and the nearer one must tell.
        sharp_weight: see ``sharp``.
        max_weight: a cell's average weighs at most this against the next observation.
        spacing: endpoints nearer than this to each other are averaged to one vertex [m] ...
        widest_spacing, vertices: ... and those up to so far from each other [m], where a scan has more vertices than
            this: what it costs, and what it weighs, depends little on how many beams the lidar has.
        gap, gap_from_range: a surface is drawn between neighbouring endpoints up to ``gap + gap_from_range * range``
            apart [m], [m/m].
    """

    cell_size: Annotated[Number, Field(ge=0.01, le=1.0)] = 0.08
    truncation: Positive = 0.16
    coarse_truncation: Positive = 0.4
    coarse_chord: Annotated[Number, Field(ge=0, le=10)] = 0.5
    sharp: Positive = 0.06
    sharp_weight: Annotated[Whole, Field(ge=1, le=31)] = 8
    max_weight: Annotated[Whole, Field(ge=1, le=31)] = 31
    spacing: Positive = 0.02
    widest_spacing: Positive = 0.06
    vertices: Annotated[Whole, Field(ge=8, le=100_000)] = 200
    gap: Positive = 0.3
    gap_from_range: NotNegative = 0.03

    @model_validator(mode="after")
    def _surfaces_reach_the_cells_beside_them(self) -> SurfaceConfig:
        for name, cell, reach in (
            ("", self.cell_size, self.truncation),
            ("coarse_", 2 * self.cell_size, self.coarse_truncation),
        ):
            if not cell <= reach <= LONGEST_REACH * cell:
                raise ValueError(
                    f"{name}truncation of {reach:g} m, expected {cell:g} to {LONGEST_REACH * cell:g} m: 1 to "
                    f"{LONGEST_REACH} of the {'coarse' if name else 'fine'} level's cells at cell_size "
                    f"{self.cell_size:g}"
                )
        return self


class RegistrationConfig(Section):
    """How scans are registered to the particles' maps (method ``surface``): Gauss-Newton from coarse to fine.

    Attributes:
        residual: standard deviation of an endpoint's distance to the surface [m].
        coarse_residual_factor: by what it is multiplied on the coarse level.
        likelihood_width: standard deviation, in units of ``residual``, of a distance r in an endpoint's likelihood
            exp(-(r / width)^2 / 2): above 1, since few distances fit to within one ``residual``.
        ray_clearance: a ray crosses a surface of the map if it meets one this far from its endpoint [truncations] ...
        ray_weight: ... in a cell that weighs more than this ...
        ray_distance: ... and is nearer to the surface than this [truncations].
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
    coarse_residual_factor: Annotated[Number, Field(ge=0.1, le=100)] = 2.0
    likelihood_width: Annotated[Number, Field(ge=0.1, le=100)] = 2.0
    ray_clearance: Annotated[Number, Field(ge=0, le=100)] = 2.0
    ray_weight: Annotated[Whole, Field(ge=0, le=31)] = 4
    ray_distance: Share = 1 / 3
    translation: Annotated[Number, Field(gt=0, le=1)] = 0.01
    translation_from_translation: Share = 0.07
    rotation: Annotated[Number, Field(gt=0, le=1)] = 0.01
    rotation_from_rotation: Share = 0.2
    guess_translation: Share = 0.05
    guess_rotation: Share = 0.05
    prior_weight: Positive = 5.0
    iterations: Annotated[Whole, Field(ge=1, le=100)] = 8
    sure_above: Share = 0.75
    doubtful_below: Share = 0.6
    lost_below: Number = 0.04
    wide_distance: Annotated[Number, Field(ge=0, le=10)] = 1.5
    wide_rotation: Annotated[Number, Field(ge=0, le=3.2)] = 1.4
    clear_gain: NotNegative = 0.3
    patience: Annotated[Whole, Field(ge=0)] = 3
    points: Annotated[Whole, Field(ge=8, le=100_000)] = 1000
    degenerate: NotNegative = 0.001


class CalibrationConfig(Section):
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

    enabled: Truth = True
    scale: Positive = 0.05
    curvature: Positive = 0.02
    lever: Positive = 0.1
    change: NotNegative = 0.001
    translation: Positive = 0.005
    translation_from_translation: NotNegative = 0.03
    rotation: Positive = 0.01
    rotation_from_rotation: NotNegative = 0.1
    gate: Positive = 3.0


class ProposalConfig(Section):
    """How the particles of the method ``surface`` spread around what registration found, and are weighed.

    Attributes:
        information_share: share of the endpoints' information that counts: their errors are not independent.
        translation, translation_from_translation, rotation, rotation_from_rotation: standard deviation of the
            odometry where the endpoints say nothing [m], [m/m], [rad], [rad/rad].
        drawn: share of those of the way that the particles are drawn with; all of it where colours weigh them. Where
            nothing ever tells, resampling keeps one of the particles by chance, off by as much as they are apart.
        evidence_share: share of the endpoints' log-likelihood that counts in the weights, for the same reason.
        explore: every other particle starts its registration at a place drawn from the odometry's prior.
        unknown: log-likelihood lost for an endpoint where the map knows nothing.
        outlier: log-likelihood lost at most for an endpoint.
        crossing: log-likelihood lost for a ray through a surface of the map.
    """

    information_share: Annotated[Number, Field(gt=0, le=1)] = 1.0
    translation: NotNegative = 0.001
    translation_from_translation: NotNegative = 0.02
    rotation: NotNegative = 0.0005
    rotation_from_rotation: NotNegative = 0.02
    drawn: Share = 0.25
    evidence_share: Annotated[Number, Field(gt=0, le=1)] = 0.03
    explore: Truth = False
    unknown: NotNegative = 2.0
    outlier: NotNegative = 8.0
    crossing: NotNegative = 1.0


class ColourConfig(Section):
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
        spread_translation: standard deviation of what the floor can tell at best [m]; what is off in a map of it is off
            for every frame that is compared with it.
    """

    enabled: Truth = False
    cell_size: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.02
    max_depth: Annotated[Number, Field(ge=0.5, le=8)] = 3.0
    largest_age: NotNegative = 0.25
    map_length: Annotated[Number, Field(ge=0.2, le=20)] = 1.0
    reach: Annotated[Number, Field(ge=0.02, le=0.5)] = 0.04
    least_known: Annotated[Number, Field(gt=0, le=1)] = 0.3
    spread: Positive = 60.0
    share: Annotated[Number, Field(gt=0, le=1)] = 0.1
    spread_translation: Positive = 0.01
