"""Glass, black and shiny surfaces: which beams come back, and from where."""

from __future__ import annotations

import numpy as np
import pytest

from moteslam.sim.scenario import parse_scenario
from moteslam.sim.sensors.echoes import Scene
from moteslam.sim.world.layout import Layout, Wall
from moteslam.sim.world.pieces import MATERIALS, Material
from moteslam.sim.world.world import World

pytestmark = pytest.mark.usefixtures("taichi")

N = 20_000


def pane(material: str, **tables: Material) -> Scene:
    """A wall of a material at x = 2 from y = -9 to 9, and a plain one at x = 5."""
    front = Wall(points=((2.0, -9.0), (2.0, 9.0)), material=material)
    behind = Wall(points=((5.0, -30.0), (5.0, 30.0)))
    return Scene(World.of(Layout(walls=(front, behind), materials=tables)))


def measured(scene: Scene, angle: float, x: float = 0.0) -> np.ndarray:
    """What N beams from (x, 0) in one direction measure [m]."""
    origins = np.tile((x, 0.0), (N, 1))
    return scene.echoes(origins, np.full(N, angle), np.zeros(N), np.random.default_rng(1), max_range=30.0)


@pytest.mark.parametrize(("angle", "share"), [(0.0, 0.2), (0.6, 0.92), (-1.0, 0.92)])
def test_glass_lets_a_share_of_the_beams_pass(angle: float, share: float) -> None:
    ranges = measured(pane("glass"), angle)
    passed = np.isclose(ranges, 5.0 / np.cos(angle), atol=2e-3)
    assert passed.mean() == pytest.approx(share, abs=0.02)
    np.testing.assert_allclose(ranges[~passed], 2.0 / np.cos(angle), atol=1e-4)


def test_black_answers_only_from_near() -> None:
    scene = pane("black")
    near, far = measured(scene, 0.0, x=-4.5), measured(scene, 0.0, x=-5.5)
    assert np.isnan(near).mean() == pytest.approx(0.05, abs=0.01)
    np.testing.assert_allclose(near[np.isfinite(near)], 6.5, atol=1e-3)
    assert np.isposinf(far).all()  # 7.5 m away, and what is behind it is hidden
    assert np.isposinf(measured(scene, 0.9, x=-2.2)).all()  # 6.8 m away but aslant: 7 m * sqrt(cos 0.9) = 5.5 m


def test_a_mirror_measures_the_path_to_what_it_shows() -> None:
    # a beam at 0.7 rad to the normal meets the mirror at x = 2 and goes back to the wall at x = -3
    front = Wall(points=((2.0, -9.0), (2.0, 9.0)), material="mirror")
    back = Wall(points=((-3.0, -30.0), (-3.0, 30.0)))
    always = Material(mirrors=1.0, lobe=0.1)
    scene = Scene(World.of(Layout(walls=(front, back), materials={"mirror": always})))
    np.testing.assert_allclose(measured(scene, 0.7), (2.0 + 5.0) / np.cos(0.7), atol=1e-3)
    np.testing.assert_allclose(measured(scene, 0.0), 2.0, atol=1e-5)  # it shows the sensor itself
    shiny = measured(pane("shiny"), 0.7)
    seen = np.isclose(shiny, 2.0 / np.cos(0.7), atol=1e-4)
    assert seen.mean() == pytest.approx(0.3 * 0.9, abs=0.02)
    assert np.isnan(shiny).mean() == pytest.approx(0.3 * 0.1, abs=0.01)


def test_materials_of_ones_own_and_unknown_ones(table: dict) -> None:
    table["world"]["boxes"] = [{"centre": [8.0, 7.0], "size": [1.0, 1.0], "material": "velvet"}]
    table["world"]["materials"] = {"velvet": {"reach": 3.0}}
    world = World.of(parse_scenario(table).world)
    assert [list(world.palette.values())[i].reach for i in world.surfaces] == [None] * 4 + [3.0] * 4
    assert MATERIALS["plain"] == Material()
