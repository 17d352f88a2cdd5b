"""The small scenario that the tests of the simulator share."""

from typing import Any

import pytest
from sim_drives import room_table

from moteslam.sim.scenario import Scenario, parse_scenario


@pytest.fixture
def table() -> dict[str, Any]:
    """As TOML gives it, to be changed."""
    return room_table()


@pytest.fixture
def scenario(table: dict[str, Any]) -> Scenario:
    return parse_scenario(table)
