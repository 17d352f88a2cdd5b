"""Parameters of registration, of the correlative search, and of tracking between updates."""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from moteslam.robot.values import NotNegative, Number, Positive, Section, Share, Whole


class RegistrationConfig(Section):
    """Registration of scans to the particles' TSDFs: Gauss-Newton from coarse to fine."""

    # Standard deviation of an endpoint's distance to the surface [m]
    residual: Annotated[Number, Field(ge=1e-4, le=1)] = 0.01
    # On the coarse level the residual's standard deviation is this many times as large
    coarse_residual_factor: Annotated[Number, Field(ge=0.1, le=100)] = 2.0
    # An endpoint at distance r from the surface has the likelihood exp(-(r / (width residual))^2 / 2), 0 to 1: wider
    # than the residual, so that it separates scans that fit from those that do not
    likelihood_width: Annotated[Number, Field(ge=0.1, le=100)] = 2.0
    # A ray crosses a surface of the map that it meets at least this far before its endpoint [truncations] and leaves
    ray_clearance: Annotated[Number, Field(ge=0, le=100)] = 2.0
    # Cells of at most this weight are no surface that a ray can cross
    ray_weight: Annotated[Whole, Field(ge=0, le=31)] = 4
    ray_distance: Share = 1 / 3  # A ray meets a surface where a cell's distance to it is below this [truncations]
    # Standard deviation of the odometry of one motion, at rest [m]
    translation: Annotated[Number, Field(gt=0, le=1)] = 0.01
    # Added to that for every metre [m/m]: a loose prior, since the odometry's errors are systematic
    translation_from_translation: Share = 0.07
    # Standard deviation of the odometry's heading of one motion, at rest [rad]
    rotation: Annotated[Number, Field(gt=0, le=1)] = 0.01
    rotation_from_rotation: Share = 0.2  # Added to that for every radian of turn [rad/rad]
    # Added to the standard deviation of a motion that was extrapolated at a constant velocity, not measured [m]
    extrapolated_translation: Share = 0.05
    extrapolated_rotation: Share = 0.05  # Added to that of its heading [rad]
    prior_weight: Positive = 5.0  # So many independent endpoints weigh as much as the odometry: neighbours err alike
    iterations: Annotated[Whole, Field(ge=1, le=100)] = 8  # Gauss-Newton steps at most, on each level
    # At most this many points of a thinned scan, evenly chosen, are registered to the TSDFs of all particles
    max_points: Annotated[Whole, Field(ge=8, le=100_000)] = 1000
    unknown_cost: NotNegative = 2.0  # Negative log-likelihood of an endpoint where the map is unknown
    outlier_cost: NotNegative = 8.0  # Largest negative log-likelihood of an endpoint
    # Standard deviation of what is found along the least informed direction, times the ratio of its information to that
    # of the best informed, where the endpoints' distances to the surface deviate by `residual` [m]; it grows with their
    # variance. Along two bare walls the odometry is kept instead; 0 turns it off.
    degenerate: NotNegative = 0.001
    gate: Positive = 3.0  # An offset of more standard deviations of the odometry must be proved by the endpoints


class SearchConfig(Section):
    """The lattice of a search, and which of its places become starts."""

    # Between the headings that are searched [rad]; positions are a cell apart
    heading_step: Annotated[Number, Field(gt=0, le=1)] = 0.02
    basin_distance: Positive = 0.2  # Gauss-Newton converges from starts up to this far off [m]
    basin_rotation: Positive = 0.06  # Gauss-Newton converges from starts whose heading is off by up to this [rad]
    separation: Positive = 0.6  # Starts are at least this share of the basin apart
    search_near: Positive = 0.2  # Points nearer to a surface than this count for a place [m]
    search_prior: Positive = 0.01  # What a deviation from the prediction costs: share of the truncation at every point
    # Edge of the blocks of lattice places of which the best is kept
    search_block: Annotated[Whole, Field(ge=1, le=1000)] = 10

    @property
    def basin(self) -> NDArray[np.float64]:
        """[3] of Gauss-Newton: x [m], y [m], theta [rad]."""
        return np.array([self.basin_distance, self.basin_distance, self.basin_rotation])


class TrackingConfig(SearchConfig):
    """Tracking between updates: when a scan is searched for, when it counts as lost, where it is looked for again."""

    # A scan whose endpoints have at least this mean likelihood, 0 to 1, where registration finds it from the prediction
    # is accepted without a search, if `accept_deviation` allows
    accept_likelihood: Share = 0.75
    accept_deviation: Positive = 6.0  # A scan is accepted without a search only so many deviations from the prediction
    window: Positive = 3.0  # Half width of the search window [standard deviations of the prediction]
    retry_likelihood: Share = 0.6  # A scan of less mean likelihood after the search is searched for from more starts
    min_starts: Annotated[Whole, Field(ge=1, le=1000)] = 2  # Smallest number of registrations started in a search
    # Largest number of registrations started in a search; it grows with the window. Where the prediction is uncertain
    # by more than `basin_distance` or half a radian, it is `retry_starts`.
    max_starts: Annotated[Whole, Field(ge=1, le=1000)] = 16
    # Registrations started where a scan is searched for again
    retry_starts: Annotated[Whole, Field(ge=1, le=1000)] = 200
    relocation_starts: Annotated[Whole, Field(ge=1, le=1000)] = 300  # Registrations started in the relocation window
    # Points of a scan that are registered from every start
    start_points: Annotated[Whole, Field(ge=8, le=100_000)] = 90
    # The prior's tails are heavier than the normal distribution's beyond this many nats, for the predictions by
    # odometry and by constant velocity: what odometry is off by has outliers
    prior_tail: Positive = 3.0
    # A scan of a smaller match score, as a share of its points, contradicts the map: it is lost, and looked for in the
    # relocation window
    lost_score: Annotated[Number, Field(ge=-1, le=2)] = 0.04
    relocation_distance: Annotated[Number, Field(ge=0, le=10)] = 1.5  # Half width of the relocation window [m]
    # Half width of the relocation window in heading [rad]
    relocation_rotation: Annotated[Number, Field(ge=0, le=3.2)] = 1.4
    # ... but only where no scan was registered for so long [s]: who is seen all the time does not leap
    relocation_after: NotNegative = 0.0
    relocation_gain: NotNegative = 0.3  # A lost scan is relocated where its score is larger by this share of its points
    # Up to this many lost scans in a row are left out of the maps; the next is accepted where it was found
    max_lost_scans: Annotated[Whole, Field(ge=0)] = 3
    score_likelihood: Positive = 1.5  # Added to the match score for an endpoint of likelihood 1 [points]
    score_known: NotNegative = 0.3  # Subtracted from the match score for every endpoint where the map is known [points]
    # Subtracted from the match score for every ray through a surface [points]: little, since doors open and people walk
    score_crossing: NotNegative = 0.3
    # Scans of fewer thinned points carry no information: the odometry alone moves the particles
    min_points: Annotated[Whole, Field(ge=1)] = 5
    # Odometry has slipped where registration is off by more than this many of its standard deviations. What was just
    # off, by a slip or a wrong stamp, is likely to be as far off in the next step, or back: its standard deviation is
    # larger by as much there.
    slip_threshold: Positive = 2.0
    # A motion that nothing measured is extrapolated to at most this many times the time of the step before; over a
    # longer one constant velocity is no alternative to the odometry
    max_extrapolation: Positive = 10.0
