"""The house: who imports whom, in functions and for types too; and what is built and pinned."""

import ast
import tomllib
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

ROOT = Path(__file__).parents[2]
FOLDERS = ("kernels", "robot", "sim", "slam", "eval")
COMPOSERS = {
    "eval": set(),
    "sim": {"simulate.py", "simulator.py", "scenario.py"},
    "slam": {
        *("core.py", "config.py", "tsdf/config.py", "paper/config.py", "backend/graph/config.py"),
        *("known_map/config.py", "known_map/filter.py"),
    },
}
"""The packages that are held to this, and the files that compose a simulation, a run, or the configuration of a run and
may import from every subfolder."""
MAX_SIBLINGS = 2
"""Subfolders beside its own that any other file imports from."""
QUIET = ("kernels", "robot", "sim", "slam")
"""Packages whose messages name no command-line option: `eval/cli` adds it."""


def files(package: str) -> list[Path]:
    return sorted((ROOT / package).rglob("*.py"))


def module(file: Path) -> str:
    parts = file.relative_to(ROOT).with_suffix("").parts
    return ".".join(("moteslam", *(parts[:-1] if parts[-1] == "__init__" else parts)))


@cache
def modules() -> frozenset[str]:
    return frozenset(module(file) for folder in FOLDERS for file in files(folder))


@cache
def imported(file: Path) -> frozenset[str]:
    """The modules of this project that a file imports, wherever in it."""
    found: set[str] = set()
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, f"{file} imports relatively"
            for alias in node.names:  # of `from moteslam.robot import se2` the module is the name, not the package
                name = f"{node.module}.{alias.name}"
                found.add(name if name in modules() else str(node.module))
    return frozenset(name for name in found if name.startswith("moteslam."))


def subfolder(name: str, package: str) -> str | None:
    """The folder directly below a package that a module is in; None at its top or in another package."""
    parts = name.split(".")
    inside = parts[:2] == ["moteslam", package] and len(parts) > 2 and (ROOT / package / parts[2]).is_dir()
    return parts[2] if inside else None


@pytest.mark.parametrize("package", COMPOSERS)
def test_a_file_imports_from_at_most_two_sibling_folders(package: str):
    for file in files(package):
        if file.relative_to(ROOT / package).as_posix() in COMPOSERS[package]:
            continue
        own = subfolder(module(file), package)
        siblings = {folder for name in imported(file) if (folder := subfolder(name, package)) not in (None, own)}
        assert len(siblings) <= MAX_SIBLINGS, f"{file.relative_to(ROOT)} imports from {sorted(siblings)}"


@pytest.mark.parametrize("package", COMPOSERS)
def test_no_file_imports_itself_by_way_of_others(package: str):
    graph = {module(file): imported(file) for file in files(package)}
    assert_no_circle(graph)


@pytest.mark.parametrize("package", COMPOSERS)
def test_folders_and_the_files_at_the_top_form_layers(package: str):
    graph: dict[str, set[str]] = {}
    for file in files(package):
        own = subfolder(module(file), package) or module(file)
        inside = [name for name in imported(file) if name.startswith(f"moteslam.{package}.")]
        below = {subfolder(name, package) or name for name in inside}
        graph.setdefault(own, set()).update(below - {own})
    assert_no_circle(graph)


def assert_no_circle(graph: dict[str, set[str]] | dict[str, frozenset[str]]) -> None:
    try:
        TopologicalSorter(graph).prepare()
    except CycleError as error:
        pytest.fail(" <- ".join(error.args[1]))


def test_the_robot_is_few_files_that_need_few_others():
    graph = {module(file): {name for name in imported(file) if ".robot" in name} for file in files("robot")}
    assert len(graph) <= 31
    assert sum(map(len, graph.values())) <= 123


@pytest.mark.parametrize("package", QUIET)
def test_no_message_names_an_option_of_the_command_line(package: str):
    for file in files(package):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Raise):
                texts = [part.value for part in ast.walk(node) if isinstance(part, ast.Constant)]
                flags = [text for text in texts if isinstance(text, str) and " --" in f" {text}"]
                assert not flags, f"{file.relative_to(ROOT)}:{node.lineno} names {flags}"


@pytest.mark.parametrize("file", files("kernels"), ids=lambda file: file.name)
def test_functions_of_the_kernels_that_run_on_the_host_are_annotated(file: Path):
    """mypy asks for less in these files, since Taichi's own functions have no annotations."""
    for function in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        if not isinstance(function, ast.FunctionDef):
            continue
        if any(ast.unparse(d).removeprefix("ti.") in ("kernel", "func") for d in function.decorator_list):
            continue
        arguments = function.args
        given = (*arguments.posonlyargs, *arguments.args, *arguments.kwonlyargs, arguments.vararg, arguments.kwarg)
        bare = [a.arg for a in given if a is not None and a.annotation is None and a.arg not in ("self", "cls")]
        assert not bare, f"{function.name}: {bare}"
        assert function.returns is not None, function.name


PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PINS = [
    line.strip()
    for line in (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    if line.strip() and not line.startswith("#")
]


def test_every_package_folder_is_built():
    found = {"moteslam"}
    for folder in FOLDERS:
        for file in (ROOT / folder).rglob("__init__.py"):
            found.add(".".join(("moteslam", *file.parent.relative_to(ROOT).parts)))
    assert sorted(PROJECT["tool"]["setuptools"]["packages"]) == sorted(found)


@pytest.mark.parametrize("package", ["sim.scenarios", "robot.platforms", "eval.sweep.specs", "eval.metrics"])
def test_the_bundled_files_are_built(package: str):
    patterns = PROJECT["tool"]["setuptools"]["package-data"][f"moteslam.{package}"]
    folder = ROOT.joinpath(*package.split("."))
    built = {file for pattern in patterns for file in folder.glob(pattern)}
    others = {file for file in folder.iterdir() if file.is_file() and file.suffix != ".py"}
    assert built == others


def test_every_requirement_is_pinned_within_its_bounds():
    pinned = {canonicalize_name(name): version for name, version in (pin.split("==") for pin in PINS)}
    extras = PROJECT["project"]["optional-dependencies"].values()
    for text in (*PROJECT["project"]["dependencies"], *(line for extra in extras for line in extra)):
        requirement = Requirement(text)
        assert pinned[canonicalize_name(requirement.name)] in requirement.specifier, text
