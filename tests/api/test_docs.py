"""The documentation names what is there, and what README and guide ask a newcomer to do works."""

import importlib.util
import re
import shlex
import subprocess
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
import typer
from pydantic import BaseModel

import moteslam
from moteslam.eval.cli import main
from moteslam.sim.scenario import load_scenario
from moteslam.slam.config import load_preset, preset_names

ROOT = Path(__file__).parents[2]
PAGES = sorted([*ROOT.glob("*.md"), *ROOT.glob("docs/**/*.md")])
PAPER = (ROOT / "docs" / "theory" / "paper.md").read_text(encoding="utf-8")


def keys(model: BaseModel, prefix: str = "") -> set[str]:
    """The dotted keys of a configuration, those of its sections too."""
    found = set()
    for name, value in model:
        found.add(prefix + name)
        if isinstance(value, BaseModel):
            found |= keys(value, f"{prefix}{name}.")
    return found


KEYS = set().union(*(keys(load_preset(name)) for name in preset_names()))
"""Of all bundled methods."""

SCENARIO_KEYS = keys(load_scenario("corridor"))


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub makes them."""
    titles = re.findall(r"^#+ (.*)$", page.read_text(encoding="utf-8"), re.M)
    return {re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-") for title in titles}


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_within_the_project_lead_somewhere(page: Path):
    for target, anchor in re.findall(r"\]\((?!https?:)([^)#]*)(?:#([^)]+))?\)", page.read_text(encoding="utf-8")):
        there = page.parent / target if target else page
        assert there.exists(), f"{page.name} links to {target}"
        assert not anchor or anchor in anchors(there), f"{page.name} links to {target}#{anchor}"


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_keys_given_to_set_exist(page: Path):
    for line in page.read_text(encoding="utf-8").splitlines():
        for key in re.findall(r"--set ([a-z_.]+)=", line):
            command = re.search(r"moteslam (simulate|replay|demo)", line)
            known = {None: SCENARIO_KEYS | KEYS, "simulate": SCENARIO_KEYS}.get(command and command[1], KEYS)
            assert key in known, f"{page.name} sets {key}"


def test_files_functions_and_keys_that_the_pages_name_exist():
    sections = {key.partition(".")[0] for key in KEYS if "." in key}
    files, functions, keys = set(), set(), set()
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        files |= set(re.findall(r"`((?:kernels|robot|sim|slam|eval)/[a-z_/]+\.(?:py|toml))`", text))
        functions |= set(re.findall(r"`((?:kernels|robot|sim|slam|eval)/[a-z_/]+)\.([A-Za-z_]+)[`(]", text))
        if page.parent.name == "theory":
            named = set(re.findall(r"`([a-z_]+\.(?!py|pgm|png)[a-z_]+)`", text))
            keys |= {key for key in named if key.partition(".")[0] in sections}
    assert min(len(files), len(functions), len(keys)) > 15
    assert not [file for file in files if not (ROOT / file).exists()]
    assert keys <= KEYS
    for file, name in functions:
        if name not in ("toml", "py"):
            source = (ROOT / f"{file}.py").read_text(encoding="utf-8")
            assert re.search(rf"^(?:def|class) {name}\b", source, re.M), f"{file}.{name}"


def test_the_paper_page_gives_the_values_of_the_preset():
    preset = load_preset("paper")
    for key, value in (
        ("map.cell_size", f"{preset.map.cell_size:g} m"),
        ("motion.velocity", f"{preset.motion.velocity:g} m/s"),
        ("motion.yaw_rate", f"{preset.motion.yaw_rate:g} rad/s"),
        ("map.occupied_threshold", f"above {preset.map.occupied_threshold:g} "),
        ("update.distance", f"{preset.update.distance:g} m or {preset.update.rotation:g} rad"),
        ("motion.translation_from_translation", f"{preset.motion.translation_from_translation:g} m/m"),
        ("motion.translation_from_translation", f"{preset.motion.translation_from_rotation:g} m/rad"),
        ("motion.translation_from_translation", f"{preset.motion.rotation_from_translation:g} rad/m"),
        ("motion.translation_from_translation", f"{preset.motion.rotation_from_rotation:g} rad/rad"),
        ("search.offsets_xy", ", ".join(f"{offset:g}" for offset in preset.search.offsets_xy)),
        ("map.count", f'"{preset.map.count}"'),
        ("sync.method", f'"{preset.sync.method}"'),
        ("sync.low_pass_hz", f"= {preset.sync.low_pass_hz:g}`"),
    ):
        rows = [line for line in PAPER.splitlines() if line.startswith("|") and f"`{key}" in line]
        assert any(f"{value} ".strip() in row for row in rows), f"{key}: {value}"


@pytest.fixture(scope="module")
def generate() -> ModuleType:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "generate.py")
    made = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(made)
    return made


def test_the_generated_pages_say_what_every_key_is(generate: ModuleType):
    page = generate.configuration()
    blocks = "".join(re.findall(r"```toml\n(.*?)```", page, re.S))
    said = re.findall(r"^(\w+) = .*?(?:  # (.*))?$", blocks, re.M)
    assert len(said) > 100
    assert not [key for key, comment in said if len(comment) < 10]
    for names in moteslam.PUBLIC.values():
        assert all(re.search(rf"^::: .*\.{name}$", generate.names(), re.M) for name in names)


README = (ROOT / "README.md").read_text(encoding="utf-8")
GUIDE = (ROOT / "docs" / "guide" / "python.md").read_text(encoding="utf-8")


def written() -> list[tuple[str, str]]:
    """The page and the words of every command of the program, in blocks of code and in running text with an option."""
    found = []
    for page in PAGES:
        text = page.read_text(encoding="utf-8").replace("\\\n", " ")
        for language, block in re.findall(r"^```(\w*)\n(.*?)^```", text, re.M | re.S):
            if language not in ("", "bash"):
                continue
            found += [(page.name, line) for line in re.findall(r"^(?:\$ | +)?moteslam (.*)$", block, re.M)]
        text = re.sub(r"^```.*?^```", "", text, flags=re.M | re.S)
        found += [(page.name, line) for line in re.findall(r"`moteslam ([a-z]+ [^`\n]*--[^`\n]*)`", text)]
    return found


WRITTEN = written()


@pytest.mark.parametrize(("page", "line"), WRITTEN, ids=[f"{page}: {line}" for page, line in WRITTEN])
def test_a_command_of_the_pages_is_understood(page: str, line: str):
    """Its options exist and have values, and it has the arguments that it needs; files need not be there."""
    words = [word.replace("...", "") for word in shlex.split(line, comments=True)]
    for end in ("|", ">", "&&", "2>"):
        words = words[: words.index(end)] if end in words else words
    command: Any = typer.main.get_command(main.app)
    context, name = None, "moteslam"
    while words and hasattr(command, "resolve_command"):
        context = command.make_context(name, words, parent=context)
        name, command, words = command.resolve_command(context, [*context._protected_args, *context.args])
    command.make_context(name, words, parent=context)


@pytest.mark.slow
@pytest.mark.usefixtures("taichi")
def test_the_commands_of_the_tutorial_run(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    text = (ROOT / "docs" / "tutorial.md").read_text(encoding="utf-8")
    name, content = re.findall(r"<!-- (\S+) -->\n```toml\n(.*?)^```", text, re.M | re.S)[0]
    monkeypatch.chdir(tmp_path)
    Path(name).write_text(content.replace('"0-5"', '"0-1"'), encoding="utf-8")
    commands = [line for page, line in WRITTEN if page == "tutorial.md" and " --set " not in line]
    assert len(commands) >= 10
    for line in commands:
        assert main.run(shlex.split(line)) == 0, line
    assert Path("luck.html").exists()


@pytest.mark.slow
def test_the_example_finds_its_way():
    example = re.search(r"```python\n(.*?)```", README, re.S)
    command = [sys.executable, "-c", example.group(1)]
    run = subprocess.run(command, check=False, capture_output=True, text=True)
    assert run.returncode == 0, run.stderr
    found = re.fullmatch(r"off by ([0-9.]+) mm over ([0-9]+) m\n", run.stdout)
    assert found is not None, run.stdout
    assert float(found.group(1)) < 20
    assert int(found.group(2)) >= 80


@pytest.mark.slow
def test_the_blocks_of_the_guide_run_one_after_the_other(tmp_path: Path):
    blocks = re.findall(r"^```python\n(.*?)^```", GUIDE, re.M | re.S)
    assert len(blocks) > 6
    command = [sys.executable, "-c", "\n".join(blocks)]
    run = subprocess.run(command, check=False, capture_output=True, text=True, cwd=tmp_path)
    assert run.returncode == 0, run.stderr
    first, *_, last = run.stdout.splitlines()
    found = re.fullmatch(r"([0-9.]+) cm over [0-9]+ m", first)
    assert found is not None, run.stdout
    assert float(found.group(1)) < 5
    assert last.startswith("no such.log - No such file")
