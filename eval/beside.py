"""What lies beside a recording to score a run by: a truth, a true map, relations."""

from __future__ import annotations

from pathlib import Path

from moteslam.eval.metrics.relations import Relations, is_relations, read_relations
from moteslam.robot.formats.map_server import read_map
from moteslam.robot.raster import Raster


def folder_of(recording: Path) -> Path:
    """A recording's own folder, or the one that a log lies in."""
    return recording if recording.is_dir() else recording.parent


def truth_file(recording: Path) -> Path | None:
    """``truth.tum`` in a recording's folder, or beside a log; None where there is none."""
    file = folder_of(recording) / "truth.tum"
    return file if file.exists() else None


def reference_file(recording: Path) -> Path | None:
    """``NAME.reference.tum`` beside a log of that name; None where there is none."""
    file = recording.parent / f"{recording.name.partition('.')[0]}.reference.tum"
    return file if recording.is_file() and file.exists() else None


def true_map_beside(recording: Path) -> Raster | None:
    """The true map, ``truth_map.yaml``; None where there is none.

    Raises:
        InputError: it cannot be read.
    """
    file = folder_of(recording) / "truth_map.yaml"
    return read_map(file) if file.exists() else None


def relations_beside(recording: Path) -> Relations | None:
    """Hand-checked relations, ``NAME.relations``; None where there are none.

    Raises:
        InputError: they cannot be read.
    """
    file = recording.parent / f"{recording.name.partition('.')[0]}.relations"
    return read_relations(file) if is_relations(file) else None
