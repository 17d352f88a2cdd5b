"""What kernels refuse, by the argument's name: arrays read beyond their ends, numbers without a meaning."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from refusals import refusal
from tile_pools import MIDDLE, OPTIONS, REGISTRATION, Pool, frames, tiles_of

from moteslam.errors import InputError
from moteslam.kernels.camera import render_colour, view_of
from moteslam.kernels.checks import as_finite, check_array
from moteslam.kernels.correlative import MAX_SEARCH_POINTS, search_scans
from moteslam.kernels.matching import match_poses
from moteslam.kernels.motion import sample_motion
from moteslam.kernels.normals import scan_normals
from moteslam.kernels.occupancy import update_grid
from moteslam.kernels.raycast import build_buckets, cast_movers, cast_rays
from moteslam.kernels.registration import RegistrationOptions, register_scans
from moteslam.kernels.scan_pairs import MAX_PARTNERS, accumulate, match_endpoints
from moteslam.kernels.scans import ThinnedScan, project_scans, thin_scan
from moteslam.kernels.texture import add_frame
from moteslam.kernels.tiles import CELLS
from moteslam.kernels.tsdf import IntegrationOptions, integrate_scans

pytestmark = pytest.mark.usefixtures("taichi")

F = np.float32
PAIRS = np.zeros((3, 2), F)
READ_ONLY = PAIRS.copy()
READ_ONLY.setflags(write=False)
TABLE = tiles_of(np.zeros(CELLS, np.int16), np.zeros((1, 2, 2), np.int32))
TWO_TABLES = tiles_of(np.zeros(CELLS, np.int16), np.zeros((2, 2, 2), np.int32))
RAYS = np.ones((2, 3, 4))  # Of a camera of 2 by 3 pixels
PARTNERS = np.array([(1, -1, -1), (0, -1, -1)], np.int32)  # Of two scans of two points each


def checked(array: Any) -> None:
    check_array("array", array, np.float32, (None, 2), written=True)


def integrated(scans: list[ThinnedScan], frames: Any, **options: float) -> None:
    pool = Pool.empty()
    try:
        integrate_scans(pool.store(), frames, scans, options=IntegrationOptions(**(OPTIONS | options)))  # type: ignore[arg-type]
    except InputError:
        assert not pool.tables.any()  # nothing is written before all is checked
        raise


def rendered(rays: Any = RAYS, height: float = 0.5, **arguments: Any) -> None:
    view = view_of(rays, height=height)
    reaches = np.full((1, len(view.bearings)), 5.0, F) if "reaches" not in arguments else arguments.pop("reaches")
    render_colour(view, np.zeros((1, 3)), reaches, corner=(0.0, 0.0), **arguments)


CALLS: dict[Callable[..., object], dict[str, Any]] = {
    checked: {},
    update_grid: {
        "log_odds": np.zeros((24, 32), np.int16), "occupied": np.zeros((24, 32), np.uint8),
        "seen": np.zeros((24, 32), np.int32), "start": (2, 5), "ends": [(9, 9)], "hit": 7, "miss": 3, "limit": 20,
        "threshold": 6, "scan": 1,
    },
    match_poses: {
        "occupied": np.zeros((8, 8), np.uint8), "origin": (0, 0), "cell_size": 0.1, "poses": [(0, 0, 0)],
        "points": [(0.1, 0.1)], "offsets_xy": (0.0,), "offsets_theta": (0.0,),
    },
    sample_motion: {"poses": np.zeros((4, 3)), "motion": (0, 0, 0), "spread": (1, 1, 1), "seed": 0, "step": 0},
    scan_normals: {
        "points": np.zeros((3, 2)), "joined": np.ones(3, np.int32), "starts": [0, 3], "reach": 0.3, "noise": 0.005,
        "largest": 0.1,
    },
    cast_rays: {"buckets": build_buckets([(0, 0, 1, 0)]), "origins": [(0, 0)], "angles": [0.0], "max_range": 1.0},
    cast_movers: {
        "discs": np.zeros((5, 1, 3), F), "lines": np.zeros((5, 1, 4), F), "rate": 10.0, "origins": [(0.0, 0.0)],
        "angles": [0.0], "times": [0.0], "ranges": np.zeros(1, F),
    },
    project_scans: {
        "ranges": np.ones((2, 4), F), "directions": np.ones((4, 2)), "origin": (0, 0), "sweeps": np.zeros((2, 3)),
        "max_range": 5.0,
    },
    thin_scan: {"points": [(1, 1), (1, 2)], "origin": (0, 0), "spacing": 0.02, "gap": 0.3},
    integrated: {"frames": frames([MIDDLE]), "scans": [ThinnedScan(np.ones((2, 2), F), np.ones(2, np.int32))]},
    search_scans: {
        "tiles": TABLE, "frame": np.ones(4), "points": [(0.1, 0.1)], "turns": [0.0], "turn_costs": [0.0],
        "shifts": np.zeros((4, 2)), "shift_costs": np.zeros(4), "blocks": 2, "cell_size": 0.05, "near": 0.5,
    },
    register_scans: {
        "tiles": TABLE, "queries": np.ones((3, 13)), "points": [(0.1, 0.1)], "origin": (0, 0),
        "options": RegistrationOptions(**REGISTRATION),
    },
    match_endpoints: {
        "points": np.zeros((4, 2), F), "normals": np.ones((4, 2), F), "owners": np.array([0, 0, 1, 1], np.int32),
        "partners": PARTNERS, "reach": 1.0, "agreement": 0.8,
    },
    accumulate: {
        "points": np.zeros((4, 2), F), "normals": np.ones((4, 2), F), "starts": np.array([0, 2, 4], np.int32),
        "poses": np.zeros((2, 3)), "partners": PARTNERS, "matches": np.full((4, 3), -1, np.int32), "scale": 1.0,
    },
    rendered: {"floor": np.zeros((4, 4), np.int32), "cell_size": 0.1, "noise": np.zeros(12, F), "starts": [0]},
    add_frame: {
        "sums": np.zeros((10, 10, 4), np.int64), "disparity": np.zeros((2, 2), np.uint16),
        "rgb": np.zeros((2, 2, 3), np.uint8), "pose": (0, 0, 0), "corner": (0, 0), "cell_size": 0.05,
        "calibration": np.ones(10), "mount": np.column_stack((np.eye(3), (0.2, 0.0, 0.36))), "height_limit": 0.1,
        "max_depth": 5.0, "nothing": 2047,
    },
}  # fmt: skip
"""Arguments that are taken."""
BAD: dict[Callable[..., object], dict[str, list[Any]]] = {
    checked: {
        "array": [None, [(0, 0)], np.zeros((3, 2)), PAIRS[:, :1].copy(), PAIRS[0], np.zeros((2, 3), F).T, READ_ONLY]
    },
    update_grid: {"start": [(0, 5), (2, 23)], "ends": [[(31, 5)], [(5, -1)], [(5, 2**33)], [(5.0, 6.0)]]},
    match_poses: {"occupied": [np.ones((8, 8), np.uint8), np.zeros((8, 12), np.uint8)]},
    sample_motion: {"poses": [np.zeros((8, 3))[::2]]},
    scan_normals: {"starts": [[], [1, 3], [0, 2], [0, 4], [0, 2, 1, 3]]},
    cast_rays: {"angles": [[0.0, 1.0]]},
    cast_movers: {"lines": [np.zeros((4, 1, 4), F)], "times": [[0.0, 1.0]]},
    project_scans: {"directions": [np.ones((3, 2))], "sweeps": [np.zeros((3, 3))]},
    thin_scan: {"points": [[(0, np.nan)], [0, 0]]},
    integrated: {"frames": [frames([MIDDLE, MIDDLE])]},
    search_scans: {"tiles": [TWO_TABLES], "frame": [np.ones((2, 4))], "points": [np.zeros((MAX_SEARCH_POINTS + 1, 2))]},
    register_scans: {"tiles": [TWO_TABLES], "queries": [np.ones((3, 12))]},
    match_endpoints: {
        "owners": [np.full(4, 2, np.int32)],
        "partners": [np.array(bad, np.int32) for bad in ([(0,) * (MAX_PARTNERS + 1)] * 2, [(2, 2, 2)] * 2)],
    },
    accumulate: {
        "matches": [np.full((4, 3), 4, np.int32), np.zeros((3, 3), np.int32)], "starts": [np.zeros(3, np.int32)],
    },
    rendered: {"starts": [[1], [-1]], "reaches": [np.ones((1, 1), F)]},
}  # fmt: skip
"""Of each argument, which the refusal names."""
NARROW = {key: np.zeros((24, 30), dtype) for key, dtype in
          (("log_odds", np.int16), ("occupied", np.uint8), ("seen", np.int32))}  # fmt: skip
TOGETHER: list[tuple[Callable[..., object], dict[str, Any], str]] = [
    (update_grid, NARROW, "occupied"),
    (integrated, {"scans": [ThinnedScan(np.ones((2, 2), F), np.ones(3, np.int32))]}, "scan"),
    (integrated, {"scans": []}, "frames"),
    (rendered, {"noise": np.zeros(11, F)}, "starts"),
    (add_frame, {"height_limit": 0.4, "flat": True}, "mount"),
]
"""Arguments that do not go together, or whose refusal names another one."""


@pytest.mark.parametrize("call", CALLS, ids=lambda call: call.__name__)
def test_refused(call: Callable[..., object]) -> None:
    alone = [({name: value}, name) for name, values in BAD.get(call, {}).items() for value in values]
    for changes, field in alone + [(changes, field) for each, changes, field in TOGETHER if each is call]:
        with refusal(InputError, field=field):
            call(**CALLS[call] | changes)
    if CALLS[call]:
        call(**CALLS[call])


def test_arrays_that_are_taken_are_not_copied() -> None:
    assert check_array("ends", PAIRS, np.float32, (3, 2), written=True) is PAIRS
    assert as_finite("ends", PAIRS, np.float32, (None, None)) is PAIRS
