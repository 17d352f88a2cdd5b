"""Files and values that nobody means well with: refused at once, in one line, whatever reads them."""

import gzip
import os
import subprocess
import sys
from pathlib import Path

import pytest
from command_lines import refused

TUM = "0 0 0 0 0 0 0 1\n1 1 0 0 0 0 0 1\n2 2 0 0 0 0 0 1\n"
FLASER = f"FLASER 180 {' '.join(['1.5'] * 180)} 0 0 0 0 0 0 {{0}} host {{0}}\n"
CARMEN = "".join(FLASER.format(stamp) for stamp in range(5))
DIGITS = "1" * 5000
BRACKETS = "[" * 20_000 + "]" * 20_000
PLAN = "image: {0}\nresolution: 0.05\norigin: [0, 0, 0]\nnegate: 0\noccupied_thresh: 0.65\nfree_thresh: 0.25\n"
WALL = "[[world.walls]]\npoints = [[-5.0, 3.0], [5.0, 3.0]]\n"
ROUTE = "[route]\nwaypoints = [[0.0, 0.0], [1.0, 0.0]]\n"


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Good files beside the bad ones, in the working folder."""
    monkeypatch.chdir(tmp_path)
    Path("ok.tum").write_text(TUM)
    Path("ok.log").write_text(CARMEN)


@pytest.mark.skipif(not Path("/dev/zero").exists(), reason="devices of POSIX")
@pytest.mark.parametrize("strange", ["/dev/zero", "pipe"])
@pytest.mark.parametrize(
    "line",
    [
        "replay ok.log --out x --config {}",
        "inspect {}",
        "evaluate {} ok.tum",
        "simulate plan.toml --out x",
        "simulate floor.toml --out x",
    ],
)
def test_devices_and_pipes_are_refused_at_once(line: str, strange: str, capsys) -> None:
    os.mkfifo("pipe")
    path = Path(strange).absolute()
    Path("plan.toml").write_text(f"{ROUTE}[world.plan]\nfile = '{path}'\n")
    Path("floor.toml").write_text(f"{ROUTE}[floor]\nmaterial = 'image'\nimage = '{path}'\n{WALL}")
    before = sorted(Path().iterdir())
    said = refused(capsys, *line.format(strange).split())
    assert any(words in said for words in ("is no regular file", "neither a file nor a folder", "lies elsewhere"))
    assert sorted(Path().iterdir()) == before


PEAK = """
import sys
from moteslam.eval.cli.main import run
from moteslam.robot.formats import lines
lines.MAX_TEXT = 400_000_000
code = run(sys.argv[1:])
with open("/proc/self/status") as status:
    print(next(line.split()[1] for line in status if line.startswith("VmHWM")))
sys.exit(code)
"""
"""Prints the most memory that the process ever had [kB]; ``ru_maxrss`` counts that of the process before it, too."""


@pytest.mark.slow
@pytest.mark.skipif(not Path("/proc/self/status").exists(), reason="memory as Linux counts it")
def test_a_gzip_that_unpacks_to_far_more_is_refused_in_little_memory() -> None:
    """To a short log and 430 MB of comments, where 400 MB are the most; every process takes some 150 MB."""
    member = gzip.compress(b"# a comment of a log that goes on and on\n" * 25_000)
    Path("bomb.log.gz").write_bytes(gzip.compress(CARMEN.encode()) + member * 420)
    command = [sys.executable, "-c", PEAK, "inspect", "bomb.log.gz"]
    done = subprocess.run(command, capture_output=True, text=True, check=False, timeout=300)
    assert done.returncode == 2
    assert done.stderr.startswith("moteslam: bomb.log.gz: over")
    assert int(done.stdout) * 1024 < 300e6


@pytest.mark.parametrize(
    ("name", "content", "line", "words"),
    [
        ("a.toml", f"particles = {DIGITS}\n", "demo --config a.toml", "a.toml"),
        ("a.toml", f"seed = {BRACKETS}\n", "simulate a.toml --out x", "a.toml: not TOML: "),
        ("a.toml", "particles = 9\n# " + 4_000_000 * "x", "demo --config a.toml", "a.toml: over 4 MB"),
        ("a.tum", TUM + f"{DIGITS} 1 1 0 0 0 0 1\n", "evaluate a.tum ok.tum", "a.tum:4: "),
        ("a.log", FLASER.format(DIGITS), "inspect a.log", "a.log"),
        ("map.yaml", PLAN.format(BRACKETS), "simulate plan.toml --out x", "map.yaml"),
        ("a", "", f"replay ok.log --out x --set particles={BRACKETS}", "--set particles"),
    ],
    ids=lambda value: value[:20] if isinstance(value, str) else None,
)
def test_long_numbers_and_deep_brackets(name: str, content: str, line: str, words: str, capsys) -> None:
    Path("plan.toml").write_text(f"{ROUTE}[world.plan]\nfile = 'map.yaml'\n")
    Path(name).write_text(content)
    before = sorted(Path().iterdir())
    said = refused(capsys, *line.split())
    assert words in said
    assert len(said) < 1000
    assert sorted(Path().iterdir()) == before
