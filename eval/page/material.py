"""What a report is made of: the runs of sweeps and result folders, alike."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import tomli_w

from moteslam.errors import InputError
from moteslam.eval.runs import MAX_BYTES, grouped, is_result_folder, prefix_of, read_result_folder
from moteslam.eval.sweep.store import Row, opened
from moteslam.robot.files import read_text
from moteslam.robot.tables import read_toml

DEPTH = 3
"""Of folders in which result folders are looked for."""


@dataclass
class Material:
    """All that a report is made of.

    Attributes:
        runs: in their order, those that were made.
        documents: title and text of what was run: specifications of sweeps, configurations.
        facts: title, and names with values: versions, hardware.
        pending, wanted: runs of sweeps that were not made yet, and metrics that the specifications name.
    """

    runs: list[Row] = field(default_factory=list)
    documents: list[tuple[str, str]] = field(default_factory=list)
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    pending: int = 0
    wanted: list[str] = field(default_factory=list)

    @property
    def issues(self) -> Counter[str]:
        """What was wrong with recordings and runs, and how many runs had it."""
        return Counter(str(issue["message"]) for run in self.runs for issue in run.issues)


def gather(paths: Sequence[Path]) -> Material:
    """Read files of sweeps, result folders, and folders that hold any of these.

    Raises:
        InputError: a path of another kind, or damaged; or no run.
    """
    found: list[Path] = []
    for path in paths:
        within = list(_within(path, DEPTH)) if path.is_dir() else [path]
        if not within:
            raise InputError("no result folder and no .sweep file in it, expected some", file=path)
        if not path.exists():
            raise InputError("there is no such file or folder, expected a .sweep file or a result folder", file=path)
        found += within
    folders, sweeps = ([path for path in found if path.is_dir() == wanted] for wanted in (True, False))
    material = Material()
    for path in sweeps:
        _take_sweep(material, path, prefix_of(path, found))
    _take_folders(material, folders)
    if not material.runs:
        raise InputError("no run was made yet, expected at least one", file=paths[0])
    return material


def _within(folder: Path, depth: int) -> Iterable[Path]:
    """Result folders and files of sweeps in a folder, itself included, by name."""
    if is_result_folder(folder):
        yield folder
        return
    try:
        entries = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"cannot be read: {error.strerror or error}", file=folder) from error
    for entry in entries:
        if entry.suffix == ".sweep" and entry.is_file():
            yield entry
        elif depth > 0 and entry.is_dir() and not entry.is_symlink() and not entry.name.startswith("."):
            yield from _within(entry, depth - 1)


def _take_sweep(material: Material, path: Path, prefix: str) -> None:
    with opened(path) as store:
        spec = json.loads(store.spec)
        material.wanted += [name for name in spec.get("metrics") or () if name not in material.wanted]
        material.documents.append((f"Specification of {path.name}", tomli_w.dumps(spec)))
        for title, facts in store.environment.items():
            material.facts.setdefault(f"{title} of {path.name}", dict(facts))
        rows = [row.renamed(prefix + row.run.configuration) for row in store.rows()]
    made = [row for row in rows if row.status]
    material.runs += made
    material.pending += len(rows) - len(made)
    if programs := {row.run.configuration: row.run.version for row in made if row.run.version}:
        material.facts[f"programs of {path.name}"] = programs


def _take_folders(material: Material, folders: Sequence[Path]) -> None:
    """Result folders: those of one configuration, by the text of ``config.toml``, are runs of it."""
    rows = [read_result_folder(folder) for folder in folders]
    texts = grouped(rows, lambda row: read_text(_config(row), "a file of a result folder", limit=MAX_BYTES))
    names = _names(texts)
    for text, members in texts.items():
        material.documents.append((f"Configuration {names[text]}", text))
        material.runs += [row.renamed(names[text]) for row in members]
        for row in members:
            for title, facts in row.facts.items():
                material.facts.setdefault(title.capitalize(), dict(facts))


def _config(row: Row) -> Path:
    assert row.folder is not None
    return row.folder / "config.toml"


def _names(texts: dict[str, list[Row]]) -> dict[str, str]:
    """A name for each configuration: what it sets otherwise than the first one, else the folder of its runs."""
    if len(texts) < 2:
        return dict.fromkeys(texts, "configuration")
    tables = {text: _flat(read_toml(_config(rows[0]), "a config.toml")) for text, rows in texts.items()}
    keys = dict.fromkeys(key for table in tables.values() for key in table)
    first = next(iter(tables.values()))
    changed = [key for key in keys if any(table.get(key) != first.get(key) for table in tables.values())]
    names: dict[str, str] = {}
    for text, rows in texts.items():
        folders = [_config(row).parent for row in rows]
        together = len(rows) > 1 and len({folder.parent for folder in folders}) == 1
        name = folders[0].parent.name if together else folders[0].name
        if 0 < len(changed) <= 3:
            name = ", ".join(f"{key}={tables[text].get(key, '-')}" for key in changed)
        same = sum(name == other or other.startswith(f"{name} (") for other in names.values())
        names[text] = f"{name} ({same + 1})" if same else name
    return names


def _flat(table: dict[str, Any], prefix: str = "") -> dict[str, Any]:
    flat: dict[str, Any] = {}
    for key, value in table.items():
        flat |= _flat(value, f"{prefix}{key}.") if isinstance(value, dict) else {f"{prefix}{key}": value}
    return flat
