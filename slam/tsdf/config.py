"""The configuration of the method ``tsdf``."""

from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny

from moteslam.robot.values import NotNegative, Number, Positive, Section, Share, Truth, Whole
from moteslam.slam.backend.graph.config import GraphConfig
from moteslam.slam.backend.protocol import BackendConfig
from moteslam.slam.config import Method, ParticleFilterConfig, made_on_demand
from moteslam.slam.filter.update_policy import UpdateConfig
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.odometry.calibration import CalibrationConfig
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig


class ProposalConfig(Section):
    """How particles are sampled around their registered poses, and weighed."""

    # Share of the endpoints' information that counts when particles are sampled
    information_share: Annotated[Number, Field(gt=0, le=1)] = 1.0
    # Standard deviation that particles are sampled with where the endpoints carry no information, at rest [m]
    translation: NotNegative = 0.001
    translation_from_translation: NotNegative = 0.02  # Added to that for every metre [m/m]
    # Standard deviation that headings are sampled with where the endpoints carry no information, at rest [rad]
    rotation: NotNegative = 0.0005
    rotation_from_rotation: NotNegative = 0.02  # Added to that for every radian of turn [rad/rad]
    # Share of that standard deviation of the position which particles are sampled with; all of it where colours weigh
    # them. Where no measurement tells particles apart, resampling keeps one of them at random, and its error is of the
    # size of their spread.
    sampled_share: Share = 0.25
    # Share of the endpoints' log-likelihood that counts in the weights: neighbouring endpoints err alike
    evidence_share: Annotated[Number, Field(gt=0, le=1)] = 0.03
    crossing_cost: NotNegative = 1.0  # Negative log-likelihood of a ray through a surface of the map
    # Particles within this distance of the best one, and `mode_rotation` in heading, form its mode [m]; the online pose
    # is the mean of that mode
    mode_distance: Positive = 0.5
    mode_rotation: Positive = 0.2  # See `mode_distance` [rad]


class ColourConfig(Section):
    """Colours of the floor as one more likelihood of the particles."""

    enabled: Truth = False  # Use them where there are camera images
    cell_size: Annotated[Number, Field(ge=0.01, le=0.5)] = 0.02  # Of the maps of the floor that are compared [m]
    max_depth: Annotated[Number, Field(ge=0.5, le=8)] = 3.0  # Floor deeper than this is left out [m]
    largest_age: NotNegative = 0.25  # Of a frame when the scan is taken [s]
    # Distance for which a map of the floor is built [m]; it is compared with for as long again
    map_length: Annotated[Number, Field(ge=0.2, le=20)] = 1.0
    # How far to each side of the registered pose the floor is searched [m]
    reach: Annotated[Number, Field(ge=0.02, le=0.5)] = 0.04
    coarse_step: Annotated[Number, Field(ge=0.002, le=0.5)] = 0.02  # Steps of the first search over the floor [m]
    # Steps of the second search, around the best place of the first [m]
    fine_step: Annotated[Number, Field(ge=0.0005, le=0.5)] = 0.004
    least_known: Annotated[Number, Field(gt=0, le=1)] = 0.3  # Share of a frame's cells that must lie on known floor
    spread: Positive = 60.0  # Scale of a cell's difference, red, green and blue together [levels]
    limit: Annotated[Whole, Field(ge=1, le=765)] = 150  # Largest difference of a cell that counts [levels]
    # Share of the cells' log-likelihood that counts: neighbouring cells err alike
    share: Annotated[Number, Field(gt=0, le=1)] = 0.1
    spread_translation: Positive = 0.01  # Standard deviation of the floor's offset at best [m]


class TsdfFilterConfig(ParticleFilterConfig):
    """All keys of a run of the method ``tsdf``; the defaults are the preset ``default``."""

    method: Literal["tsdf"] = "tsdf"
    # Number of particles, each with a TSDF of its own; the largest number where `kld` adapts it
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] = 30
    update: UpdateConfig = UpdateConfig(distance=0.1, rotation=0.1)
    thinning: ThinningConfig = ThinningConfig()
    tsdf: TsdfConfig = TsdfConfig()
    registration: RegistrationConfig = RegistrationConfig()
    tracking: TrackingConfig = TrackingConfig()
    calibration: CalibrationConfig = CalibrationConfig()
    proposal: ProposalConfig = ProposalConfig()
    backend: SerializeAsAny[BackendConfig] = GraphConfig()
    colours: ColourConfig = ColourConfig()


METHOD = Method(TsdfFilterConfig, made_on_demand("moteslam.slam.tsdf.filter", "TsdfFilter"), needs_odometry=False)
