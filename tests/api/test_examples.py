"""The scripts of examples/ run, and each draws its picture."""

import ast
from importlib import import_module
from pathlib import Path

import pytest

import moteslam

EXAMPLES = Path(__file__).parents[2] / "examples"
MOST = {  # what ``main`` returns, at least and at most
    "closed_loop": (20.0, 30.0),
    "online": (0.0, 0.05),
    "my_weight_update": (20.0, 90.0),
    "score_my_trajectory": (0.02, 0.2),
    "real_log": (10.0, 60.0),
    "which_lidar": (0.0, 0.1),
}


def test_every_script_is_run_here():
    assert {path.stem for path in EXAMPLES.glob("*.py")} == {*MOST, "ros2_node"}


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
@pytest.mark.parametrize("name", MOST)
def test_a_script_draws_its_picture(name: str, tmp_path: Path):
    import matplotlib

    matplotlib.use("agg")
    found = import_module(name).main(tmp_path)
    assert (tmp_path / f"{name}.png").stat().st_size > 5000
    least, most = MOST[name]
    assert all(least < each < most for each in (found.values() if isinstance(found, dict) else [found]))


@pytest.mark.parametrize("path", sorted(EXAMPLES.glob("*.py")), ids=lambda path: path.stem)
def test_the_public_names_that_a_script_uses_exist_and_it_is_short(path: Path):
    text = path.read_text(encoding="utf-8")
    named = [node for node in ast.walk(ast.parse(text)) if isinstance(node, ast.Attribute)]
    used = {node.attr for node in named if isinstance(node.value, ast.Name) and node.value.id == "moteslam"}
    assert used <= {name for names in moteslam.PUBLIC.values() for name in names}
    assert text.count("\n") <= 110
