"""The figures of the paper, 1 to 8, from two sequences in the UCSD layout.

    python examples/paper_figures.py [FOLDER [UCSD]]

UCSD is a folder with the sequences 20 and 21, else these are simulated, 21 with a gyro that drifts by 30 degrees a
minute. Figures 7 and 8 are of the filter without its search, which hides the noise, 8 also without resampling.
"""

from pathlib import Path
from tempfile import TemporaryDirectory

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.distance import pdist

import moteslam
from moteslam.eval.cli.main import script
from moteslam.slam.estimate import with_texture

STAGES, NO_SEARCH = (0.25, 0.5, 0.75, 1.0), ("search.offsets_xy=[0.0]", "search.offsets_theta=[0.0]")


def simulated(folder: Path) -> Path:
    """Sequences 20 and 21: the camera keeps one frame in 30."""
    for number, drift in ((20, []), (21, ["noise.imu.gyro_bias=0.009"])):
        scenario = moteslam.load_scenario("corridor", settings=["camera.gap=1.0", "camera.gap_frames=29", *drift])
        moteslam.write_simulation(folder, moteslam.simulate(scenario, seed=number), sequence=str(number))
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
    """A map, grey or in colours, and paths on it, each with a ring at its start and a square at its end."""
    axes.use_sticky_edges = False  # a little room around the map
    if raster is not None and raster.values.ndim == 3:
        axes.imshow(np.where(raster.known[..., None], raster.values, 255), origin="lower", extent=raster.extent)
    elif raster is not None:
        moteslam.draw_map(axes, raster)
    for path in paths:
        (line,) = axes.plot(*path[:, :2].T, **({"lw": 1} | look))
        axes.plot(*path[0, :2], "o", *path[-1, :2], "s", color=line.get_color(), fillstyle="none")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.label_outer()


def picture(folder: Path, number: int, count: int = 1):
    """The axes of a figure, which is saved after the last of them."""
    look, side = {"sharex": True, "sharey": True, "squeeze": False, "layout": "compressed"}, 1 + (count == 4)
    figure, panels = plt.subplots(side, side, figsize=(5.5 * side, 5.5 * side), **look)
    yield from panels.flat
    figure.savefig(folder / f"paper_figures_{number}.png", dpi=140, bbox_inches="tight")
    plt.close(figure)


def endpoints(recording: moteslam.Recording, trajectory: moteslam.Trajectory) -> np.ndarray:
    """Every twentieth scan where a trajectory puts it [k, 2]."""
    lidar, (x, y, yaw) = recording.lidar, recording.platform.lidar.pose
    ranges, poses = lidar.ranges[::20, ::5], trajectory.poses[::20]
    cos, sin = np.cos(poses[:, 2:]), np.sin(poses[:, 2:])
    at_x, at_y = (x + ranges * np.cos(lidar.angles[::5] + yaw), y + ranges * np.sin(lidar.angles[::5] + yaw))
    ends = np.stack((poses[:, :1] + cos * at_x - sin * at_y, poses[:, 1:2] + sin * at_x + cos * at_y), axis=-1)
    return ends[np.isfinite(ranges)]


def main(folder: Path = Path(), ucsd: Path | None = None) -> float:
    """Draw all eight, and return how far apart the paths of all particles of figure 8 end at most [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory() as made:
        source = ucsd or simulated(Path(made))
        for row, sequence in enumerate((20, 21)):
            recording = moteslam.open_recording(source, sequence=sequence)
            found, maps, floors = run(recording)
            for number, rasters, look in ((1 + row, maps, {}), (3 + row, floors, {"color": "magenta", "lw": 2})):
                for axes, raster, share in zip(picture(folder, number, len(STAGES)), rasters, STAGES, strict=True):
                    show(axes, raster, found.trajectory.poses[: int(share * len(found.trajectory))], **look)
                    axes.set_title(f"sequence {sequence}, {share * np.ptp(recording.lidar.stamps):.0f} s")
            for axes in picture(folder, 6 - row):
                axes.plot(*endpoints(recording, found.dead_reckoning).T, ".", ms=0.8, mew=0, c="0.6", label="endpoints")
                show(axes, None, found.dead_reckoning.poses, color="tab:orange", label="path")
                axes.legend(title=f"sequence {sequence}, odometry", loc=(0, 1), ncols=2, markerscale=10, frameon=False)
            if sequence == 20:
                begin = moteslam.cut(recording, moteslam.Cut(end=50.0))
                spoilt, bad, _ = run(begin, *NO_SEARCH, "motion.yaw_rate=3.0")
                for axes, raster, share in zip(picture(folder, 7, len(STAGES)), bad, STAGES, strict=True):
                    show(axes, raster, spoilt.trajectory.poses[: int(share * len(spoilt.trajectory))])
                    axes.set_title(f"sequence 20, no search, yaw noise 3 rad/s, {50 * share:g} s")
                apart, *_ = run(begin, *NO_SEARCH, "resample_below=0.0")
                for axes in picture(folder, 8):
                    show(axes, None, *apart.particle_paths[::10])
                    axes.set_title(f"sequence 20, every tenth of {len(apart.particle_paths)} particles")
    most = float(pdist(apart.particle_paths[::10, -1, :2]).max())
    print(f"eight pictures; figure 8 draws every tenth particle, two of which end {most:.1f} m apart")
    return most


if __name__ == "__main__":
    script(main)
