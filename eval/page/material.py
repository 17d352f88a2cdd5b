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
from moteslam.eval.results import MAX_BYTES, is_result_folder, read_result_folder
from moteslam.eval.sweep.store import opened
from moteslam.eval.sweep.tables import group_of, succeeds
from moteslam.robot.files import read_text
from moteslam.robot.values import read_toml

SUCCESS = {"final.ate": 0.5}
"""Of runs in result folders: limits as of ``SweepSpec.success``."""
DEPTH = 3
"""Of folders in which result folders are looked for."""
Key = tuple[Any, ...]


@dataclass(frozen=True)
class ReportRun:
    """A run as the report sees it.

    Attributes:
        place: scenario or recording; platform, noise and seed are empty where they are its own or not known.
        duration: at which the drive was cut [s], if it was.
        configuration, base: its name, with what varies and without.
        status, error, absent: as of a row of a sweep.
        succeeded: whether all limits were kept.
        folder: of its result, if it has one.
    """

    place: str
    seed: int | None
    configuration: str
    base: str
    values: dict[str, float]
    absent: dict[str, str]
    succeeded: bool
    platform: str = ""
    noise: str = ""
    duration: float | None = None
    varied: tuple[tuple[str, Any], ...] = ()
    status: str = "ok"
    error: str = ""
    folder: Path | None = None

    @property
    def case(self) -> Key:
        """Runs of two configurations with the same are a pair."""
        return self.place, self.platform, self.noise, self.duration, self.seed

    @property
    def name(self) -> str:
        """For people: where it drove."""
        seed = "" if self.seed is None else f"seed {self.seed}"
        return ", ".join(filter(None, (self.place, self.platform, self.noise, seed)))


@dataclass
class Material:
    """All that a report is made of.

    Attributes:
        runs: in their order.
        units: by metric.
        documents: title and text of what was run: specifications of sweeps, configurations.
        facts: title, and names with values: versions, hardware.
        issues: what was wrong with recordings and runs, and how many runs had it.
        pending, wanted: runs of sweeps that were not made yet, and metrics that the specifications name.
    """

    runs: list[ReportRun] = field(default_factory=list)
    units: dict[str, str] = field(default_factory=dict)
    documents: list[tuple[str, str]] = field(default_factory=list)
    facts: dict[str, dict[str, str]] = field(default_factory=dict)
    issues: Counter[str] = field(default_factory=Counter)
    pending: int = 0
    wanted: list[str] = field(default_factory=list)


def gather(paths: Sequence[Path]) -> Material:
    """Read files of sweeps, result folders, and folders that hold any of these.

    Raises:
        InputError: a path of another kind, or damaged; or no run.
    """
    material = Material()
    sweeps: list[Path] = []
    folders: list[Path] = []
    for path in paths:
        if path.is_dir():
            within = list(_within(path, DEPTH))
            if not within:
                raise InputError("no result folder and no .sweep file in it, expected some", file=path)
            folders += [each for each in within if each.is_dir()]
            sweeps += [each for each in within if not each.is_dir()]
        elif not path.exists():
            raise InputError("there is no such file or folder, expected a .sweep file or a result folder", file=path)
        else:
            sweeps.append(path)
    for path in sweeps:
        _take_sweep(material, path, f"{path.stem}: " if len(sweeps) > 1 or folders else "")
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
        success = dict(spec.get("success", SUCCESS))
        material.wanted += [name for name in spec.get("metrics") or () if name not in material.wanted]
        material.documents.append((f"Specification of {path.name}", tomli_w.dumps(spec)))
        for title, facts in store.environment.items():
            material.facts.setdefault(f"{title} of {path.name}", facts)
        for row in store.rows():
            if not row.status:
                material.pending += 1
                continue
            material.units |= row.units
            material.issues.update(str(issue["message"]) for issue in row.issues)
            run = row.run
            if run.version:
                material.facts.setdefault(f"programs of {path.name}", {})[run.configuration] = run.version
            material.runs.append(
                ReportRun(
                    place=str(dict(group_of(row))["scenario"]),
                    platform=Path(run.platform).stem,
                    noise=run.noise,
                    seed=run.seed,
                    duration=run.duration,
                    configuration=prefix + run.configured,
                    varied=run.varied,
                    base=prefix + run.configuration,
                    status=row.status,
                    error=row.error,
                    values=row.known,
                    absent=row.absent,
                    succeeded=succeeds(row, success),
                )
            )


def _take_folders(material: Material, folders: Sequence[Path]) -> None:
    """Result folders: those of one configuration, by the text of ``config.toml``, are runs of it."""
    texts: dict[str, list[Path]] = {}
    for folder in folders:
        text = read_text(folder / "config.toml", "a file of a result folder", limit=MAX_BYTES)
        texts.setdefault(text, []).append(folder)
    names = _names(texts)
    for text, members in texts.items():
        material.documents.append((f"Configuration {names[text]}", text))
        material.runs += [_run_of(material, folder, names[text]) for folder in members]


def _run_of(material: Material, folder: Path, configuration: str) -> ReportRun:
    result = read_result_folder(folder)
    about, values = result.run, result.values
    material.units |= result.units
    try:
        material.issues.update(issue["message"] for issue in about.get("warnings", ()))
        for title in ("versions", "hardware"):
            facts = {name: str(value) for name, value in about.get(title, {}).items()}
            material.facts.setdefault(title.capitalize(), facts)
    except (AttributeError, KeyError, TypeError) as error:
        raise InputError("not as `moteslam replay` writes it", file=folder / "run.json") from error
    seed = about.get("seed")
    limits = [(values.get(name), limit) for name, limit in SUCCESS.items()]
    return ReportRun(
        place=str(about.get("scenario") or about.get("recording") or folder.name),
        seed=seed if isinstance(seed, int) else None,
        configuration=configuration,
        base=configuration,
        values=values,
        absent=result.absent,
        succeeded=all(value is not None and value <= limit for value, limit in limits),
        folder=folder,
    )


def _names(texts: dict[str, list[Path]]) -> dict[str, str]:
    """A name for each configuration: what it sets otherwise than the first one, else the folder of its runs."""
    if len(texts) < 2:
        return dict.fromkeys(texts, "configuration")
    tables = {text: _flat(read_toml(members[0] / "config.toml", "a config.toml")) for text, members in texts.items()}
    keys = dict.fromkeys(key for table in tables.values() for key in table)
    first = next(iter(tables.values()))
    changed = [key for key in keys if any(table.get(key) != first.get(key) for table in tables.values())]
    names: dict[str, str] = {}
    for text, members in texts.items():
        parents = {folder.parent for folder in members}
        name = next(iter(parents)).name if len(parents) == 1 and len(members) > 1 else members[0].name
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
