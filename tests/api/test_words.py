"""The lint of words finds what was given up, and leaves everyday and technical uses alone."""

from __future__ import annotations

from types import ModuleType

import pytest
from scripts import loaded


@pytest.fixture(scope="module")
def words() -> ModuleType:
    return loaded(".ci/words.py")


def found(words: ModuleType, monkeypatch: pytest.MonkeyPatch, line: str, name: str = "slam/x.py") -> list[str]:
    monkeypatch.setattr(words, "texts", lambda: [(name, line)])
    return list(words.finds())


@pytest.mark.parametrize(
    "line",
    [
        "class SurfaceMaps:",
        "from moteslam.kernels.surface import ThinScan",
        "particles that believe the same as the best one",
        "the encoders told the filter",
        "the lever of the lidar",
        "stretches of 1 m",
        "4 % of every metre of way",
        "closed after so many seconds",
        "`surface.sharp_weight` in a configuration",
        "registration.lost_below = 0.1",
        "the vertices of the thinned scan",
    ],
)
def test_old_words_are_found(words: ModuleType, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    (only, *_) = found(words, monkeypatch, line)
    assert only.startswith("slam/x.py:1: ")
    assert ", expected " in only


@pytest.mark.parametrize(
    "line",
    [
        "from typing import cast",
        "x = ti.cast(y, ti.i32)",
        "rays are cast",
        "a validation gate of three standard deviations",
        "the way home",
        "a door leaf in the robot's way",
        "what tells them apart",
        "file.tell()",
        "the surface of a table",
        "tsdf.near_weight",
        "as it did so far as is known",
    ],
)
def test_everyday_and_technical_uses_stay(words: ModuleType, monkeypatch: pytest.MonkeyPatch, line: str) -> None:
    assert found(words, monkeypatch, line) == []


def test_words_of_another_meaning_elsewhere_stay_there(words: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    assert found(words, monkeypatch, "the vertices of a wall", "sim/world/walls.py") == []


def test_the_changelogs_table_is_exempt(words: ModuleType, monkeypatch: pytest.MonkeyPatch) -> None:
    changelog = "CHANGELOG.md"
    monkeypatch.setattr(words, "files", lambda: [changelog])
    assert list(words.finds()) == []
    monkeypatch.setattr(words, "RENAMES", ("no such mark", "nor this"))
    assert all(line.startswith(changelog) for line in words.finds())
    assert list(words.finds()) != []
