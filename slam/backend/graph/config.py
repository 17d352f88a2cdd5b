"""The configuration of the back end ``graph``."""

from typing import Annotated, Literal, Self

from pydantic import Field, model_validator

from moteslam.robot.values import Number, Positive, Section, Share, Truth, Whole
from moteslam.slam.backend.protocol import BackendConfig
from moteslam.slam.inputs.config import ThinningConfig
from moteslam.slam.mapping.config import TsdfConfig
from moteslam.slam.registration.config import RegistrationConfig

MAX_PARTNERS = 32  # The kernels keep no more: `kernels.scan_pairs.MAX_PARTNERS`, not imported for its Taichi


class ChainConfig(Section):
    """Edges from each node to the one before: registration to a local TSDF of the latest nodes."""

    length: Positive = 8.0  # Path that the local TSDF covers [m], at least half of it: short, so that no loop is in it
    nodes: Annotated[Whole, Field(ge=1, le=1000)] = 12  # Nodes in it, likewise
    # At most this many points of a scan, evenly chosen, are registered
    max_points: Annotated[Whole, Field(ge=8, le=100_000)] = 400


class LoopConfig(Section):
    """The search for loops, and what proves them."""

    enabled: Truth = True  # Look for loops
    least_path: Positive = 15.0  # Two nodes form a loop from this much path between them on [m]
    every: Positive = 2.0  # A node is searched for in other nodes' submaps each time the robot has driven this far [m]
    # Places this far apart may show the same walls: candidates are nodes within it, and three standard deviations of
    # their relative position [m]
    near: Positive = 2.0
    # Loops whose relative position has up to this standard deviation are searched first; then it is doubled, again and
    # again [m]. What is proved makes the next searches smaller.
    first_deviation: Positive = 0.5
    rounds: Annotated[Whole, Field(ge=1, le=100)] = 8  # Rounds of search and solution at the end, at most
    # Passages of the same place that one node is searched for in, for each of these deviations
    candidates: Annotated[Whole, Field(ge=1, le=100)] = 3
    submap_length: Positive = 5.0  # Path of the nodes of a submap [m]; longer by what the window exceeds half a metre
    query_length: Positive = 4.0  # Path of the nodes whose scans are searched for together [m]
    least_share: Share = 0.3  # Share of the endpoints that must lie on surfaces of the submap, less what contradicts it
    least_margin: Share = 0.1  # No place half a metre or 0.15 rad off may have a share within this of the best one's


class JointConfig(Section):
    """The joint registration of all nodes."""

    enabled: Truth = True  # Register nodes jointly: those that a correction moves on the way, and all at the end
    # Other scans that the endpoints of one are held to, at most
    partners: Annotated[Whole, Field(ge=1, le=MAX_PARTNERS)] = 16
    first_reach: Positive = 0.3  # Largest distance of an endpoint to its surface in a wide search's first round [m]
    last_reach: Positive = 0.1  # The same in its last rounds, and where poses are known well [m]
    # Rounds at most; it ends when the poses move by less than a millimetre (root mean square)
    rounds: Annotated[Whole, Field(ge=1, le=1000)] = 40

    @model_validator(mode="after")
    def _shrinks(self) -> Self:
        if self.last_reach > self.first_reach:
            raise ValueError(f"last_reach {self.last_reach:g}, expected at most first_reach, {self.first_reach:g}")
        return self


class GraphConfig(BackendConfig):
    """Loops, pose graph and joint registration behind the filter."""

    # The back end behind the filter: `none`, `graph`, or one that another package brings
    method: Literal["graph"] = "graph"
    distance: Positive = 0.5  # A key scan becomes a node of the graph after this distance [m] ...
    rotation: Positive = 0.5  # ... or this turn [rad].
    # No further node is made where this many are within `distance` and `rotation` already: a place that is passed again
    # and again is known, and the graph ends growing with the map
    crowd: Annotated[Whole, Field(ge=1, le=10_000)] = 20
    # Neighbouring endpoints err alike: this many of them count as one
    correlation: Annotated[Number, Field(ge=1, le=1000)] = 10.0
    graduated: Truth = True  # Reject loops that the others contradict, by graduated non-convexity
    chain: ChainConfig = ChainConfig()
    loops: LoopConfig = LoopConfig()
    joint: JointConfig = JointConfig()
    thinning: ThinningConfig = ThinningConfig()
    tsdf: TsdfConfig = TsdfConfig()
    registration: RegistrationConfig = RegistrationConfig()
