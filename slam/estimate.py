"""The result of a SLAM run, with its configuration, seed and versions."""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import InputError
from moteslam.robot.formats.map_server import map_image
from moteslam.robot.raster import Raster, encode_png
from moteslam.robot.recording import Recording
from moteslam.robot.trajectory import PoseGraph, Trajectory
from moteslam.robot.values import Issue, Summarised
from moteslam.slam.backend.building import Building
from moteslam.slam.backend.protocol import LoopCandidate
from moteslam.slam.config import SlamConfig
from moteslam.slam.texture.floor_map import TextureMap, TextureMapper, can_map, map_texture


class Correction(NamedTuple):
    """A path that the back end corrected, and the map with it."""

    scan: int  # index of the scan after which
    path: NDArray[np.float64]  # [k, 3] poses of the first k updates, in the map from then on


@dataclass(frozen=True, eq=False, repr=False)
class Estimate(Summarised):
    """The result of a run.

    Attributes:
        name: of the recording.
        config, seed: that it was run with.
        versions: of moteslam, taichi, numpy.
        trajectory: a pose at every scan, as it was known then (online).
        trajectory_final: a pose at every scan, as known at the end: the path of the best particle, or the back end's.
        dead_reckoning: a pose at every scan by odometry alone.
        map: of the environment: float32 log-odds, 0 unknown, above 0 occupied.
        particle_stamps: [u] of the updates of the filter [s].
        particle_paths: [K, u, 3] paths that end in the particles of the last update.
        particle_ancestors: [K, u] index of each path's particle among those of every update; paths with the same index
            have the same past.
        particle_spread: [u, 3] weighted standard deviation of all particles after every update: along and across their
            mean heading [m], and of the heading [rad].
        covariances: [n, 3, 3] of the online pose at every scan, in the robot's frame, relative to the map around it.
        diagnostics: per scan [n]: ``particles``, ``n_eff``, ``score``, ``updated``, ``resampled``, ``seconds``;
            ``degenerate``, the heading of a degenerate direction in the robot's frame [rad], NaN without one;
            ``wrong``, the probability that the online pose is wrong, and ``state``, that in a word, a
            ``LocalisationState`` (0 sure, 1 doubtful, 2 lost); ``corrected``, how far the back end moved the robot
            after the scan, with the map [m], 0 where it did not.
        warnings: what SLAM had to do without.
        seconds: time spent in filter and back end [s].
        corrections: what the back end corrected while the robot drove, in order.
        loops: what the back end looked for and found, in the order of the search; empty without one.
        building: the run as a session that others can be bound to, or all sessions that it is bound to; None without
            such a back end.
        texture: the floor in colours, None without images, if not asked for, or if it failed.
    """

    name: str
    config: SlamConfig
    seed: int
    versions: dict[str, str]
    trajectory: Trajectory
    trajectory_final: Trajectory
    dead_reckoning: Trajectory
    map: Raster
    particle_stamps: NDArray[np.float64]
    particle_paths: NDArray[np.float64]
    particle_ancestors: NDArray[np.int64]
    particle_spread: NDArray[np.float64]
    covariances: NDArray[np.float64]
    diagnostics: dict[str, NDArray[np.float64]]
    warnings: tuple[Issue, ...]
    seconds: float
    corrections: tuple[Correction, ...] = ()
    loops: tuple[LoopCandidate, ...] = ()
    building: Building | None = None
    texture: TextureMap | None = None

    @property
    def graph(self) -> PoseGraph | None:
        """The back end's pose graph: its nodes at their final poses, the steps between them and the accepted loops.

        As these were measured; None without one.
        """
        return None if self.building is None else self.building.graph

    def _repr_png_(self) -> bytes:
        """What a notebook shows: the map, and the path as known at the end."""
        return preview_png(self.map, self.trajectory_final.poses)

    def _summary(self) -> str:
        path = self.trajectory_final._summary()
        return f"{self.name!r}, method {self.config.method}, seed {self.seed}, {path}, map: {self.map._summary()}"


def as_logged(estimate: Estimate, stamps: NDArray[np.float64]) -> Estimate:
    """An estimate in the order of the recording, whose stamps [n] [s] are not in that in which its scans were taken."""
    order = np.argsort(stamps, kind="stable")
    updates = np.flatnonzero(estimate.diagnostics["updated"])
    at = np.argsort(order)  # where each scan lies in the recording

    def sorted_(trajectory: Trajectory) -> Trajectory:
        return Trajectory(stamps[order], trajectory.poses[order])

    def path_order(length: int) -> NDArray[np.intp]:
        return np.argsort(stamps[updates[:length]], kind="stable")

    kept = path_order(len(updates))
    return replace(
        estimate,
        trajectory=sorted_(estimate.trajectory),
        trajectory_final=sorted_(estimate.trajectory_final),
        dead_reckoning=sorted_(estimate.dead_reckoning),
        particle_stamps=stamps[updates][kept],
        particle_paths=estimate.particle_paths[:, kept],
        particle_ancestors=estimate.particle_ancestors[:, kept],
        particle_spread=estimate.particle_spread[kept],
        covariances=estimate.covariances[order],
        diagnostics={name: values[order] for name, values in estimate.diagnostics.items()},
        corrections=tuple(
            Correction(int(at[scan]), path[path_order(len(path))]) for scan, path in estimate.corrections
        ),
    )


def with_texture(
    estimate: Estimate,
    recording: Recording,
    *,
    interval: float | None = None,
    watch: Callable[[float, TextureMapper], None] | None = None,
) -> Estimate:
    """The estimate of a recording with the floor coloured along its final trajectory (section III.E of the paper).

    It is unchanged where the floor is not to be coloured, and has a warning alone where it cannot be: the estimate is
    not lost for it. ``interval``: between frames, in place of the configuration's. ``watch``: see ``map_texture``.
    """
    config = estimate.config.texture
    if not (config.enabled and can_map(recording)):
        return estimate
    config = config if interval is None else config.model_copy(update={"interval": interval})
    try:
        texture = map_texture(recording, estimate.trajectory_final, config, watch=watch)
    except InputError as error:
        issue = Issue("floor-not-coloured", f"the floor is not coloured: {error}")
        return replace(estimate, warnings=(*estimate.warnings, issue))
    return replace(estimate, texture=texture, warnings=(*estimate.warnings, *texture.warnings))


BLUE = (0x00, 0x72, 0xB2)  # Of paths, as in all pictures of SLAM
LONGEST = 800  # The longer side of a preview, at most [pixel]
ENLARGED = 8  # At most this number of pixels for a side of a cell
MARGIN = 0.5  # Around all that is known and the path [m]
SUBPIXEL = 4  # Bits of a pixel that corners of lines are rounded to


def preview_png(occupancy: Raster, path: NDArray[np.float64]) -> bytes:
    """A PNG of a map in greys and a path in colour, a ring at its start and a square at its end, the largest y on top.

    What is neither known nor near the path is cut off. Of several cells in a pixel the darkest is shown, so that walls
    stay. The map has log-odds [H, W] and is not turned, the path [n, 2 or more] has x, y [m] of one place at least.
    """
    import cv2

    places = (path[:, :2] - occupancy.origin[:2]) / occupancy.cell_size  # columns and rows, from the lowest
    size, margin = np.array(occupancy.values.shape[::-1]), int(np.ceil(MARGIN / occupancy.cell_size))
    cells = np.vstack((np.argwhere(occupancy.values)[:, ::-1], np.clip(places, 0, size - 1).astype(int)))
    left, bottom = np.maximum(cells.min(axis=0) - margin, 0)
    right, top = np.minimum(cells.max(axis=0) + 1 + margin, size)
    grey = map_image(occupancy.values[bottom:top, left:right])
    longest = max(grey.shape)
    shrink, enlarge = -(-longest // LONGEST), max(1, min(ENLARGED, LONGEST // longest))
    grey = cv2.erode(grey, np.ones((shrink, shrink), np.uint8))[shrink // 2 :: shrink, shrink // 2 :: shrink]
    image = cv2.cvtColor(np.kron(grey, np.ones((enlarge, enlarge), np.uint8)), cv2.COLOR_GRAY2RGB)

    pixels = np.stack((places[:, 0] - left, top - places[:, 1]), axis=1) * (enlarge / shrink) - 0.5
    corners = np.rint(pixels * 2**SUBPIXEL).astype(np.int32)
    cv2.polylines(image, [corners], isClosed=False, color=BLUE, thickness=2, lineType=cv2.LINE_AA, shift=SUBPIXEL)
    start, end = np.rint(pixels[[0, -1]]).astype(int).tolist()
    cv2.rectangle(image, [end[0] - 4, end[1] - 4], [end[0] + 4, end[1] + 4], BLUE, cv2.FILLED)
    cv2.circle(image, start, 7, (0, 0, 0), 2, cv2.LINE_AA)
    return encode_png(image)
