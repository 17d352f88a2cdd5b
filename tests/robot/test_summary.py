"""Values that hold arrays are shown in one line, without their numbers."""

import dataclasses
import importlib
import pkgutil

from moteslam.robot.values import Summarised


def test_every_dataclass_with_arrays_that_users_meet_is_summarised() -> None:
    missing = []
    for name in ("robot", "sim", "eval.metrics", "slam.estimate", "slam.run", "slam.texture.floor_map"):
        package = importlib.import_module(f"moteslam.{name}")
        modules = [m.name for m in pkgutil.walk_packages(getattr(package, "__path__", []), f"moteslam.{name}.")]
        modules = [module for module in modules if ".formats.bags." not in module]  # what a bag is on its way
        for module in [package, *map(importlib.import_module, modules)]:
            for kind in vars(module).values():
                if not (dataclasses.is_dataclass(kind) and isinstance(kind, type)) or kind.__name__.startswith("_"):
                    continue
                arrays = any("NDArray" in str(f.type) or str(f.type) == "Poses" for f in dataclasses.fields(kind))
                if arrays and kind.__repr__ is not Summarised.__repr__:
                    missing.append(f"{kind.__module__}.{kind.__qualname__}")
    assert not missing, "expected Summarised, and dataclass(repr=False)"
