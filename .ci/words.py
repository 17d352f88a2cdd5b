"""The lint of words: names, configuration keys and phrases that the project has given up, for the field's own.

``python .ci/words.py`` looks through the code, the TOML files and the pages that git would keep, and prints a line for
each find: file, line, what was found and what to write. Everyday and technical uses stay (typing's cast, a validation
gate, the way home, to tell apart): the patterns leave them room. ``words: ok`` in a line excepts it.
"""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from fnmatch import fnmatch
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT))

EXEMPT = ("LICENSE", ".ci/words.py", "slam/renamed.py", "tests/slam/test_config.py", "tests/api/test_words.py")
"""What must name them: this list, the table of old keys, and the tests of both."""
RENAMES = ("<!-- renames -->", "<!-- end of renames -->")
"""Around the changelog's table of renames, which is exempt."""

IDENTIFIERS = {
    r"Surface(Map|Maps|Filter|Config|View)|surface_(maps?|filter|config)|method `surface`": "TSDF: Tsdf..., tsdf_...",
    r"ThinScan|thin_vertices": "ThinnedScan",
    r"add_scans": "integrate_scans",
    r"UpdateGate|slam/gate": "UpdatePolicy",
    r"straight_gap|straightness": "nothing: removed",
    r"score_poses|march_rays|kernels[/.]marching": "nothing: removed",
    r"kernels[/.]surface|twins[/.]surfaces": "kernels/tsdf",
    r"\bsharp(_weight)?\b": "near, near_weight",
    r"\bmerits?\b": "match score",
    r"\bCast\b|in the cast\b|cast of people": "actors",
    r"\bArtist\w*\(|\bShots\b": "Renderer, CameraFrames",
    r"\bcarried_on\b": "extrapolated",
    r"\bstraight_walls\b": "nothing: removed",
}
"""Old names in code, as patterns, and what to write."""

PHRASES = {
    r"\btold\b": "measured, estimated, given, printed",
    r"\btells?\b(?![^.;\n]{0,40}\bapart\b)(?!\(\))": "measures, estimates, states, gives",
    r"\bbeliev\w*": "estimate; within ... of",
    r"\blevers?\b": "lidar offset",
    r"\bstretch(es)?\b": "segment; pair (of poses)",
    r"\bmetres? of way\b|\bways driven\b|\balong the way\b": "distance, path",
    r"\bso (many|few|much)(-th)?\b(?! (that|for|as|the))": "at most N, this many",
    r"\b(up to|at most) so far\b": "up to this distance",
    r"\bclaim(s|ed)?\b": "copy on write",
    r"\bsurface maps?\b": "TSDF",
    r"\bsketch(es)?\b": "preview",
    r"\b(wide|widest) window\b": "relocation window",
    r"\bguess(es|ed)?\b": "extrapolated; hypothesis",
    r"\bnobody (has|knows|will)\b": "plain words",
}
"""Phrases, as patterns, and what to write."""

SCOPED = {
    ("slam/*", "kernels/*", "tests/slam/*", "tests/kernels/*"): {r"\bvert(ices|ex)\b": "points (of a thinned scan)"},
}
"""Words that mean something else elsewhere: the files, and the patterns there."""


def old_keys() -> dict[str, str]:
    """Old configuration keys with dots, as patterns, and their new names."""
    scope: dict[str, dict[str, str]] = {}
    exec((ROOT / "slam/renamed.py").read_text("utf-8").split("def ")[0], scope)
    old = {**scope["RENAMED"], **dict.fromkeys(scope["REMOVED"], "nothing: removed")}
    return {rf"(?<![\w.]){re.escape(key)}(?![\w])": new for key, new in old.items() if "." in key}


def files() -> list[str]:
    """Every file that git keeps or would keep, by its path."""
    command = ("git", "ls-files", "--cached", "--others", "--exclude-standard")
    return subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=True).stdout.splitlines()


def texts() -> Iterator[tuple[str, str]]:
    """The text files of `files` by their paths, without those that are exempt and result files."""
    for name in files():
        path = ROOT / name
        if name in EXEMPT or path.suffix not in {".py", ".md", ".toml", ".c", ""} or not path.is_file():
            continue
        text = path.read_text("utf-8")
        if name == "CHANGELOG.md" and RENAMES[0] in text:
            before, _, rest = text.partition(RENAMES[0])
            table, _, after = rest.partition(RENAMES[1])
            text = before + "\n" * table.count("\n") + after
        yield name, text


def finds() -> Iterator[str]:
    """A line for each use of an old word."""
    everywhere = {**IDENTIFIERS, **PHRASES, **old_keys()}
    for name, text in texts():
        patterns = dict(everywhere)
        for files, more in SCOPED.items():
            if any(fnmatch(name, file) for file in files):
                patterns |= more
        for number, line in enumerate(text.splitlines(), start=1):
            if "words: ok" in line:
                continue
            for pattern, new in patterns.items():
                if found := re.search(pattern, line, re.IGNORECASE if pattern in PHRASES else 0):
                    yield f"{name}:{number}: {found[0].strip()!r}, expected {new}"


if __name__ == "__main__":
    found = list(finds())
    sys.stdout.write("".join(f"{line}\n" for line in found))
    sys.exit(bool(found))
