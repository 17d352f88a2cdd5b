"""moteslam: simulate a robot in a corridor, run particle-filter SLAM on what it saw, score the estimate.

The public names below are imported when first used, so that ``import moteslam`` costs nothing.
"""

from importlib import import_module
from typing import Any

PUBLIC = {
    module: tuple(names.split())
    for module, names in {
        "moteslam.errors": "BackendError ConfigError ExistsError InputError MoteslamError MoteslamWarning OutputError",
        "moteslam.eval.report.curves": "draw_error",
        "moteslam.eval.report.maps": "draw_dead_reckoning draw_loops draw_map draw_trajectories",
        "moteslam.eval.report.particles": "Cloud draw_particles",
        "moteslam.eval.report.style": "PictureStyle",
        "moteslam.robot.platform": "Platform",
        "moteslam.robot.platforms": "bundled_platforms load_platform read_platform write_platform",
        "moteslam.robot.recording": "EncoderStream ImuStream LidarStream OdometryStream Recording RgbdStream",
        "moteslam.robot.formats": "Cut cut open_recording write_recording",
        "moteslam.robot.formats.written": "write_carmen write_csv",
        "moteslam.robot.formats.ucsd": "write_ucsd",
        "moteslam.robot.formats.map_server": "read_map read_occupancy write_map",
        "moteslam.robot.inspection": "inspect_recording",
        "moteslam.robot.values": "Issue",
        "moteslam.robot.raster": "Raster read_map_arrays write_map_arrays",
        "moteslam.robot.trajectory": "PoseGraph Trajectory",
        "moteslam.robot.trajectories": "read_trajectory write_trajectory",
        "moteslam.robot.trajectories.text": "read_g2o read_kitti read_tum write_euroc write_g2o write_kitti write_tum",
        "moteslam.sim.scenario": "Scenario bundled_scenarios load_scenario",
        "moteslam.sim.simulate": "Simulation simulate",
        "moteslam.sim.simulator": "Readings Simulator",
        "moteslam.sim.output": "write_simulation",
        "moteslam.slam.config": "SlamConfig load_preset preset_names resolve_config",
        "moteslam.slam.inputs.synchronise": "dead_reckon",
        "moteslam.slam.calibration.calibrate": "Calibration calibrate",
        "moteslam.slam.calibration.findings": "Findings findings",
        "moteslam.slam.calibration.mended": "calibrated",
        "moteslam.slam.backend.protocol": "LoopCandidate",
        "moteslam.slam.estimate": "Estimate",
        "moteslam.slam.filter.certainty": "LocalisationState",
        "moteslam.slam.online": "OnlineSlam run_slam",
        "moteslam.slam.scan_records": "Update",
        "moteslam.eval.metrics.ate": "AteResult absolute_trajectory_error",
        "moteslam.eval.metrics.rpe": "drift loop_closing_error relative_pose_error",
        "moteslam.eval.metrics.residuals": "ResidualResult scan_residuals",
        "moteslam.eval.metrics.loops": "LoopResult score_loops",
        "moteslam.eval.metrics.localisation": "LocalisationResult NeesResult nees_from_start "
        "nees_interval score_localisation",
        "moteslam.eval.metrics.relations": "Relations evaluate_relations read_relations",
        "moteslam.eval.metrics.map_quality": "MapAccuracy MapConsistency map_accuracy map_consistency",
        "moteslam.eval.metrics.evidence": "Certainty Cost Evidence",
        "moteslam.eval.metrics.registry": "Metric Value measure",
        "moteslam.eval.statistics": "Comparison Proportion Summary compare",
        "moteslam.eval.scores": "evidence_of score_estimate",
        "moteslam.eval.run_tables": "read_diagnostics read_loops write_loops",
        "moteslam.eval.results": "write_results",
    }.items()
}
"""Every public name, by the module that it is defined in."""

_WHERE = {name: module for module, names in PUBLIC.items() for name in names}

__all__ = ["__version__", *_WHERE]  # noqa: PLE0604 - the keys are strings


def __getattr__(name: str) -> Any:
    if name == "__version__":
        from importlib.metadata import version

        value: Any = version("moteslam")
    elif name in _WHERE:
        value = getattr(import_module(_WHERE[name]), name)
    else:
        raise AttributeError(f"module 'moteslam' has no attribute {name!r}")
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
