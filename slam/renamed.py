"""Configuration keys that had another name: an old one is refused with the new one."""

from __future__ import annotations

RENAMED = {
    "backend.name": "backend.method",
    "method=surface": 'method = "tsdf"',
    "surface": "tsdf and thinning",
    "surface.cell_size": "tsdf.cell_size",
    "surface.truncation": "tsdf.truncation",
    "surface.coarse_truncation": "tsdf.coarse_truncation",
    "surface.sharp": "tsdf.near",
    "surface.sharp_weight": "tsdf.near_weight",
    "surface.max_weight": "tsdf.max_weight",
    "surface.spacing": "thinning.spacing",
    "surface.widest_spacing": "thinning.max_spacing",
    "surface.vertices": "thinning.max_points",
    "surface.gap": "thinning.gap",
    "surface.gap_from_range": "thinning.gap_from_range",
    "registration.guess_translation": "registration.extrapolated_translation",
    "registration.guess_rotation": "registration.extrapolated_rotation",
    "registration.points": "registration.max_points",
    "registration.sure_above": "tracking.accept_likelihood",
    "registration.doubtful_below": "tracking.retry_likelihood",
    "registration.lost_below": "tracking.lost_score",
    "registration.wide_distance": "tracking.relocation_distance",
    "registration.wide_rotation": "tracking.relocation_rotation",
    "registration.clear_gain": "tracking.relocation_gain",
    "registration.patience": "tracking.max_lost_scans",
    "proposal.drawn": "proposal.sampled_share",
    "proposal.unknown": "registration.unknown_cost",
    "proposal.outlier": "registration.outlier_cost",
    "proposal.crossing": "proposal.crossing_cost",
    "calibration.lever": "calibration.lidar_offset",
}
"""Old key, with dots, and its new name."""

REMOVED = {
    "surface.straight_gap": "surfaces across wide gaps of straight walls brought nothing",
    "surface.straightness": "surfaces across wide gaps of straight walls brought nothing",
    "proposal.explore": "registration from places drawn from the odometry's prior lost logs",
}
"""Old key, and why there is none in its place."""


def new_name(key: str) -> str | None:
    """What to say of a key that had another name, or was removed; None of any other key."""
    if key in RENAMED:
        return f"renamed, expected {RENAMED[key]}"
    if key in REMOVED:
        return f"removed: {REMOVED[key]}"
    return None
