"""moteslam: simulate a robot in a corridor, run particle-filter SLAM on what it saw, score the estimate.

The public names below are imported when first used, so that ``import moteslam`` costs nothing.
"""

from __future__ import annotations

from importlib import import_module
from typing import Any

_WHERE = {
    "BackendError": "moteslam.errors",
    "ConfigError": "moteslam.errors",
    "InputError": "moteslam.errors",
    "MoteslamError": "moteslam.errors",
    "OutputError": "moteslam.errors",
    "PictureStyle": "moteslam.robot.picture_style",
    "Platform": "moteslam.robot.platform",
    "Recording": "moteslam.robot.recording",
    "Trajectory": "moteslam.robot.trajectory",
    "open_recording": "moteslam.robot.formats",
    "Scenario": "moteslam.sim.scenario",
    "Simulation": "moteslam.sim.simulate",
    "load_scenario": "moteslam.sim.scenario",
    "simulate": "moteslam.sim.simulate",
    "Estimate": "moteslam.slam.estimate",
    "SlamConfig": "moteslam.slam.config",
    "load_preset": "moteslam.slam.settings",
    "run_slam": "moteslam.slam.run",
    "absolute_trajectory_error": "moteslam.eval.metrics.ate",
    "relative_pose_error": "moteslam.eval.metrics.rpe",
}

__all__ = ["__version__", *_WHERE]  # noqa: PLE0604 - the keys are strings


def __getattr__(name: str) -> Any:
    if name == "__version__":
        value: Any = _version()
    elif name in _WHERE:
        value = getattr(import_module(_WHERE[name]), name)
    else:
        raise AttributeError(f"module 'moteslam' has no attribute {name!r}")
    globals()[name] = value
    return value


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version("moteslam")
    except PackageNotFoundError:  # pragma: no cover - a source tree that was never installed
        return "0+unknown"


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
