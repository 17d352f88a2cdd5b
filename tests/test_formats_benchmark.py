"""``benchmarks/formats.py``, a sample of it: a drive in every format, read back and replayed."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from math import inf
from pathlib import Path

import numpy as np
import pytest
from parts.readback import HELD, STREAMS, beyond, differences, digest
from parts.readers import recorded
from scripts import ROOT

from moteslam.robot.recording import Recording

WHOLE = recorded()
assert WHOLE.lidar is not None
assert WHOLE.odometry is not None
RANGES = np.array(WHOLE.lidar.ranges)


def nudged(where: tuple[int, int], value: float) -> Recording:
    """The recording with one other range."""
    ranges = RANGES.copy()
    ranges[where] = value
    assert WHOLE.lidar is not None
    return WHOLE.replace(lidar=replace(WHOLE.lidar, ranges=ranges))


def turned(angle: float) -> Recording:
    """The recording with other headings."""
    assert WHOLE.odometry is not None
    return WHOLE.replace(odometry=replace(WHOLE.odometry, poses=np.add(WHOLE.odometry.poses, (0, 0, angle))))


def test_a_recording_differs_in_nothing_from_itself() -> None:
    for name in HELD:
        found = differences(name, WHOLE, recorded())
        assert set(found.values()) == {0.0}
        assert {field.partition(".")[0] for field in found} == set(HELD[name])
    assert digest(WHOLE) == digest(recorded())


@pytest.mark.parametrize(
    ("changed", "field", "off"),
    [
        (lambda: nudged((0, 0), np.nextafter(RANGES[0, 0], np.float32(9))), "lidar.ranges", 1e-6),
        (lambda: nudged((0, 0), np.nan), "lidar.ranges", inf),
        (lambda: nudged((0, 0), np.inf), "lidar.ranges", inf),
        (lambda: WHOLE.replace(imu=None), "imu.stamps", inf),
        (lambda: turned(2 * np.pi + 1e-6), "odometry.headings", 1.1e-6),
    ],
)
def test_what_differs_is_found(changed: Callable[[], Recording], field: str, off: float) -> None:
    other = changed()
    found = differences("csv", WHOLE, other)
    assert 0 < found[field] <= off
    assert field in beyond("csv", found)
    assert digest(other) != digest(WHOLE)


def test_the_rounding_of_a_bag_is_no_difference() -> None:
    assert "odometry.headings" in differences("bag", WHOLE, turned(np.spacing(0.05)))
    assert not beyond("bag", {"odometry.headings": float(np.spacing(np.pi)), "lidar.ranges": 0.0})
    assert beyond("bag", {"odometry.headings": 1e-12})


def test_every_stream_is_held_by_some_format() -> None:
    assert set().union(*HELD.values()) == set(STREAMS)


@pytest.mark.slow
def test_a_sample_of_the_benchmark(tmp_path: Path) -> None:
    out = tmp_path / "formats.json"
    options = ["--robots", "lms200", "--seeds", "1", "--duration", "6", "--out", str(out)]
    done = subprocess.run(
        [sys.executable, "benchmarks/formats.py", *options], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    verdicts = json.loads(out.read_text())["verdicts"]
    assert [one["format"] for one in verdicts] == list(HELD)
    assert all(one["holds"] for one in verdicts)
    assert [one["same_trajectories"] for one in verdicts] == [1] * len(HELD)
