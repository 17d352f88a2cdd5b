"""The figures of the paper, 1 to 8, from two sequences in the UCSD layout.

    python examples/paper_figures.py [FOLDER [UCSD]] [--figure N]

UCSD is a folder with the sequences 20 and 21. Without it two are simulated: the corridor with its camera, and once more
with a gyro that drifts by 30 degrees a minute. In figures 7 and 8 the filter does not search, in 8 nor resample.
"""

from argparse import ArgumentParser
from collections.abc import Collection
from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.slam.estimate import with_texture

STAGES = (0.25, 0.5, 0.75, 1.0)
NO_SEARCH = ("search.offsets_xy=[0.0]", "search.offsets_theta=[0.0]")


def simulated(folder: Path, sequence: int) -> Path:
    """Sequence 20 or 21: the camera keeps one frame in 30."""
    settings = ["camera.gap=1.0", "camera.gap_frames=29", *(["noise.imu.gyro_bias=0.009"] if sequence == 21 else [])]
    simulation = moteslam.simulate(moteslam.load_scenario("corridor", settings=settings), seed=sequence)
    moteslam.write_simulation(folder, simulation, sequence=str(sequence))
    return folder


def run(recording: moteslam.Recording, *settings: str) -> tuple[moteslam.Estimate, list, list]:
    """The paper's filter, its map at each stage, and the coloured floor at each stage."""
    slam = moteslam.OnlineSlam.over(recording, moteslam.resolve_config("paper", list(settings)))
    ends = [int(share * len(recording.lidar)) - 1 for share in STAGES]
    maps = [slam.map for update in slam if update.index in ends]
    moments, floors = recording.lidar.stamps[ends], []

    def look(stamp: float, mapper) -> None:
        while len(floors) < len(ends) and stamp >= moments[len(floors)]:
            floors.append(mapper.snapshot())

    return with_texture(slam.estimate(), recording, watch=look), maps, floors


def show(axes, raster=None, *paths: np.ndarray, **look) -> None:
    """A map, grey or in colours, and paths on it."""
    if raster is not None and raster.values.ndim == 3:
        axes.imshow(np.where(raster.known[..., None], raster.values, 255), origin="lower", extent=raster.extent)
    elif raster is not None:
        grey = np.where(raster.values > 0, 0.15, np.where(raster.values < 0, 1.0, 0.88))
        axes.imshow(grey, origin="lower", extent=raster.extent, cmap="gray", vmin=0, vmax=1)
        axes.set_facecolor("0.88")
    for path in paths:
        axes.plot(*path[:, :2].T, **({"lw": 1} | look))
    axes.set(aspect="equal", xlabel="x [m]")


def picture(folder: Path, number: int, count: int = 1):
    """The axes of a figure, which is saved after the last of them."""
    size = (3.2 * count + 2 * (count == 1), 3.6)
    figure, panels = plt.subplots(1, count, figsize=size, sharex=True, sharey=True, squeeze=False)
    yield from panels[0]
    panels[0, 0].set_ylabel("y [m]")
    figure.savefig(folder / f"paper_figures_{number}.png", dpi=80, bbox_inches="tight")
    plt.close(figure)


def stages(folder: Path, number: int, rasters: list, path: moteslam.Trajectory) -> None:
    """A figure of a raster and the path at each stage."""
    for axes, raster, share in zip(picture(folder, number, len(STAGES)), rasters, STAGES, strict=True):
        show(axes, raster, path.poses[: int(share * len(path))])
        axes.set_title(f"{share * np.ptp(path.stamps):.0f} s")


def endpoints(recording: moteslam.Recording, trajectory: moteslam.Trajectory) -> np.ndarray:
    """Every twentieth scan where a trajectory puts it [k, 2]."""
    lidar, (x, y, yaw) = recording.lidar, recording.platform.lidar.pose
    ranges, poses = lidar.ranges[::20, ::5], trajectory.poses[::20]
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    at_x, at_y = (x + ranges * np.cos(lidar.angles[::5] + yaw), y + ranges * np.sin(lidar.angles[::5] + yaw))
    ends = np.stack((poses[:, :1] + cos * at_x - sin * at_y, poses[:, 1:2] + sin * at_x + cos * at_y), axis=-1)
    return ends[np.isfinite(ranges)]


def main(folder: Path, ucsd: Path | None = None, wanted: Collection[int] = range(1, 9)) -> float:
    """Draw figures, and return how far apart the paths of figure 8 end, in y [m]; 0 without it."""
    folder.mkdir(parents=True, exist_ok=True)
    apart = 0.0
    for row, sequence in enumerate((20, 21)):
        whole, part = {1 + row, 3 + row, 6 - row} & {*wanted}, {7, 8} & {*wanted} if sequence == 20 else set()
        with TemporaryDirectory() as made:
            if whole | part:
                recording = moteslam.open_recording(ucsd or simulated(Path(made), sequence), sequence=sequence)
            if whole:
                found, *rasters = run(recording)
            for number in whole - {6 - row}:
                stages(folder, number, rasters[number // 3], found.trajectory)
            for axes in picture(folder, 6 - row) if 6 - row in whole else ():
                axes.plot(*endpoints(recording, found.dead_reckoning).T, ",", color="0.6")
                show(axes, None, found.dead_reckoning.poses, color="tab:orange")
            begin = moteslam.cut(recording, moteslam.Cut(end=50.0)) if part else None
            if 7 in part:
                spoilt, maps, _ = run(begin, *NO_SEARCH, "motion.yaw_rate=3.0")
                stages(folder, 7, maps, spoilt.trajectory)
            for axes in picture(folder, 8) if 8 in part else ():
                paths = run(begin, *NO_SEARCH, "resample_below=0.0")[0].particle_paths
                show(axes, None, *paths[::10])
                apart = float(np.ptp(paths[:, -1, 1]))
    return apart


if __name__ == "__main__":
    parser = ArgumentParser()
    parser.add_argument("folder", nargs="?", type=Path, default=".")
    parser.add_argument("ucsd", nargs="?", type=Path)
    parser.add_argument("--figure", type=int, choices=range(1, 9))
    given = parser.parse_args()
    ends = main(given.folder, given.ucsd, [given.figure] if given.figure else range(1, 9))
    print(f"pictures in {given.folder}" + (f"; the paths of figure 8 end up to {ends:.1f} m apart" if ends else ""))
