"""Parameters of the maps: the occupancy grid, and the TSDF of each particle."""

import math
from typing import Annotated, Literal, Self

import numpy as np
from pydantic import Field, model_validator

from moteslam.robot.values import NotNegative, Number, Positive, Section, Whole

MAX_TRUNCATION = 100  # Cells of a level; no truncation is longer
RESOLVED = 0.003, math.radians(0.05)  # Least deviations of a pose or step [m], [rad]: what the cells of a map resolve
LOST_DISTANCE = 0.3  # A pose that is off by more than this from the map around it is wrong [m]; ...
LOST_ROTATION = math.radians(5.0)  # ... or whose heading is off by more than this [rad]
APART = np.array([0.5, 0.5, 0.2])  # Two places are farther apart than this in one component at least [m], [m], [rad]


class MapConfig(Section):
    """The occupancy grid (sections II.A and III.C of the paper)."""

    cell_size: Annotated[Number, Field(ge=0.005, le=1.0)] = 0.05  # Of the occupancy grid [m]
    # How often the lidar is right: a cell changes by log(p / (1 - p)), log 4 at 0.8 (III.2)
    hit_probability: Annotated[Number, Field(gt=0.5, lt=1)] = 0.8
    limit: Annotated[Number, Field(gt=0, le=64)] = 50.0  # Log-odds are kept within (-limit, limit)
    occupied_threshold: Number = 0.0  # Log-odds above which a cell counts as occupied in the score (method `paper`)
    # `scan` changes a cell at most once a scan, an endpoint going over a passing ray; `ray` once for every ray that
    # meets it
    count: Literal["scan", "ray"] = "scan"
    # Cells this near to an endpoint are not freed by other rays of the same scan (`scan` only): beams that graze a wall
    # pass within a cell of where their neighbours end, and would erase it
    guard_cells: Annotated[Whole, Field(ge=0, le=16)] = 1

    # Of several sessions: what the older ones say of a cell counts as at most this much [log-odds], so that the next
    # one overrules it with three scans (at `hit_probability` 0.8); 0 lets all scans count alike
    memory: NotNegative = 4.0

    @model_validator(mode="after")
    def _can_reach_the_threshold(self) -> Self:
        if abs(self.occupied_threshold) >= self.limit:
            raise ValueError(
                f"occupied_threshold of {self.occupied_threshold:g}, expected within the limit, {self.limit:g}: beyond "
                "it no cell counts as occupied, or all do"
            )
        return self

    @property
    def log_odds_step(self) -> float:
        """The change of a cell [log-odds]: log(p / (1 - p))."""
        return math.log(self.hit_probability / (1 - self.hit_probability))


class TsdfConfig(Section):
    """The TSDF of each particle: two levels of cells, each averaging its distance to the surface (Curless and Levoy
    1996).
    """

    # Of the fine level [m]; the coarse level's cells are twice as large
    cell_size: Annotated[Number, Field(ge=0.01, le=1.0)] = 0.08
    truncation: Positive = 0.16  # Fine cells so far from a surface average their distance to it [m]; 1 to 100 cells
    coarse_truncation: Positive = 0.4  # The same of coarse cells [m]; 1 to 100 of them
    # On the coarse level the segments of a scan are joined until their chord is this long [coarse cells]: fewer
    # segments cost less
    coarse_chord: Annotated[Number, Field(ge=0, le=10)] = 0.5
    # Distances below it weigh more in a cell's average [m]: near corners and thin walls a cell has two surfaces beside
    # it, and the nearer one must count
    near: Positive = 0.06
    near_weight: Annotated[Whole, Field(ge=1, le=31)] = 8  # Distances below `near` weigh this many times as much
    # Largest weight of a cell's average against the next observation: how fast a map forgets
    max_weight: Annotated[Whole, Field(ge=1, le=31)] = 31

    @model_validator(mode="after")
    def _truncations_reach_the_cells_beside_a_surface(self) -> Self:
        for name, cell, truncation in (
            ("", self.cell_size, self.truncation),
            ("coarse_", 2 * self.cell_size, self.coarse_truncation),
        ):
            if not cell <= truncation <= MAX_TRUNCATION * cell:
                raise ValueError(
                    f"{name}truncation of {truncation:g} m, expected {cell:g} to {MAX_TRUNCATION * cell:g} m: 1 to "
                    f"{MAX_TRUNCATION} of the {'coarse' if name else 'fine'} level's cells at cell_size "
                    f"{self.cell_size:g}"
                )
        return self
