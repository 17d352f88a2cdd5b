"""The configuration of the method ``known_map``."""

from math import tau
from typing import Annotated, Literal

from pydantic import Field, SerializeAsAny, field_validator

from moteslam.robot.values import Number, Positive, Whole
from moteslam.slam.backend.protocol import BackendConfig, NoBackendConfig
from moteslam.slam.config import Method, made_on_demand
from moteslam.slam.filter.resampling import KldConfig
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.registration.config import RegistrationConfig, TrackingConfig
from moteslam.slam.tsdf.config import TsdfFilterConfig


class KnownMapConfig(TsdfFilterConfig):
    """All keys of a run of the method ``known_map``; the defaults are the preset ``localize``."""

    method: Literal["known_map"] = "known_map"  # type: ignore[assignment]
    # Number of particles while it is open where the robot is; `kld` needs fewer once it is found
    particles: Annotated[Whole, Field(ge=1, le=1_000_000)] = 200
    known_map: str = ""  # The map_server `.yaml` file of the map
    # Where the robot starts: x, y [m], theta [rad] and the standard deviation of x and y [m]; empty where nobody knows
    start: Annotated[tuple[Number, ...], Field(max_length=4)] = ()
    start_heading: Positive = 0.2  # Standard deviation of the heading of `start` [rad]
    kld: KldConfig = KldConfig(enabled=True, least=20)
    tsdf: TsdfConfig = TsdfConfig(cell_size=0.05)
    registration: RegistrationConfig = RegistrationConfig(residual=0.03, outlier_cost=4.0, unknown_cost=4.0)
    tracking: TrackingConfig = TrackingConfig(relocation_after=3.0)
    backend: SerializeAsAny[BackendConfig] = NoBackendConfig()

    @field_validator("start")
    @classmethod
    def _is_a_pose(cls, start: tuple[float, ...]) -> tuple[float, ...]:
        if len(start) > 2 and abs(start[2]) > tau:
            raise ValueError(f"a heading of {start[2]:g}, expected radians, at most a whole turn")
        if len(start) > 3 and start[3] < 0:
            raise ValueError(f"a standard deviation of {start[3]:g} m, expected 0 or more")
        return start


METHOD = Method(KnownMapConfig, made_on_demand("moteslam.slam.known_map.filter", "KnownMapFilter"))
