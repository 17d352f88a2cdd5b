"""Small scenarios that the tests of the simulator share."""

from __future__ import annotations

from typing import Any

import pytest

from moteslam.sim.scenario import Scenario, parse_scenario


@pytest.fixture
def table() -> dict[str, Any]:
    """A room of 10 m by 8 m with a route across it, as TOML gives it."""
    return {
        "world": {"rooms": [{"corner": [0.0, 0.0], "size": [10.0, 8.0]}]},
        "route": {"waypoints": [[2.0, 2.0], [7.0, 2.0], [7.0, 6.0]]},
        "drive": {"rest_start": 1.0, "rest_end": 2.0},
    }


@pytest.fixture
def scenario(table: dict[str, Any]) -> Scenario:
    """The scenario of that table."""
    return parse_scenario(table)
