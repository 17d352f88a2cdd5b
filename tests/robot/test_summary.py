"""Values that hold arrays are shown in one line, without their numbers."""

import dataclasses
import importlib
import pkgutil

import numpy as np
import pytest

from moteslam.robot.platforms import UCSD
from moteslam.robot.raster import Raster
from moteslam.robot.recording import EncoderStream, LidarStream, Recording, RgbdStream
from moteslam.robot.trajectory import Trajectory
from moteslam.robot.values import Issue, Summarised

STAMPS = np.arange(11) / 2
LIDAR = LidarStream(STAMPS, np.ones((11, 181), np.float32), -1.5, 0.01, 0.1, 30.0)


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (Trajectory(STAMPS, np.outer(STAMPS, (1, 0, 0))), "Trajectory(11 poses, 5.0 s, 5.0 m)"),
        (Trajectory(STAMPS[:0], np.zeros((0, 3))), "Trajectory(0 poses, 0.0 s, 0.0 m)"),
        (LIDAR, "LidarStream(11 scans of 181 beams, 5.0 s)"),
        (EncoderStream(STAMPS, np.zeros((11, 4), np.int64)), "EncoderStream(11 readings, 5.0 s)"),
        (RgbdStream(STAMPS, STAMPS[1:]), "RgbdStream(11 colour images, 10 disparity images)"),
        (
            Recording("two\n", UCSD, lidar=LIDAR, warnings=(Issue("gaps", "a gap"),)),
            r"Recording('two\n'; lidar: 11 scans of 181 beams, 5.0 s; 1 warning)",
        ),
        (Recording("none", UCSD), "Recording('none')"),
        (Raster(np.zeros((20, 40), np.int8), 0.05), "Raster(int8[20, 40], 2.0 x 1.0 m in cells of 0.05 m)"),
    ],
)
def test_what_is_shown(value: object, shown: str) -> None:
    assert repr(value) == shown


def test_every_dataclass_with_arrays_that_users_meet_is_summarised() -> None:
    missing = []
    for name in ("robot", "sim", "eval.metrics", "slam.estimate", "slam.texture.floor_map"):
        package = importlib.import_module(f"moteslam.{name}")
        modules = [m.name for m in pkgutil.walk_packages(getattr(package, "__path__", []), f"moteslam.{name}.")]
        modules = [module for module in modules if ".formats.bags." not in module]  # what a bag is on its way
        for module in [package, *map(importlib.import_module, modules)]:
            for kind in vars(module).values():
                if not (dataclasses.is_dataclass(kind) and isinstance(kind, type)) or kind.__name__.startswith("_"):
                    continue
                arrays = any("Array" in str(f.type) or str(f.type) == "Poses" for f in dataclasses.fields(kind))
                if arrays and kind.__repr__ is not Summarised.__repr__:
                    missing.append(f"{kind.__module__}.{kind.__qualname__}")
    assert not missing, "expected Summarised, and dataclass(repr=False)"
