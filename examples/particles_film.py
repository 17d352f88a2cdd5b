"""A film of the particles, update by update: predicted, weighed by the scan, drawn anew.

    python examples/particles_film.py [FOLDER]

It is the paper's filter without its search, so that the noise of the prediction shows, and with sharper weights.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.animation import PillowWriter

import moteslam
from moteslam.eval.cli.main import script

SECONDS, EVERY = 15.0, 3
SETTINGS = [
    "search.offsets_xy=[0.0]",
    "search.offsets_theta=[0.0]",
    "motion.yaw_rate=0.3",
    "resample_below=0.5",
    "score_exponent=6.0",
]


def endpoints(lidar: moteslam.LidarStream, mount: tuple[float, float, float], update: moteslam.Update) -> np.ndarray:
    """Where the scan of an update ends on the map [k, 2]."""
    ranges, (x, y, theta), (ahead, left, yaw) = lidar.ranges[update.index, ::6], update.pose, mount
    across = theta + yaw + lidar.angles[::6]
    x, y = x + ahead * np.cos(theta) - left * np.sin(theta), y + ahead * np.sin(theta) + left * np.cos(theta)
    ends = np.stack((x + ranges * np.cos(across), y + ranges * np.sin(across)), axis=-1)
    return ends[np.isfinite(ranges)]


def draw(plan, near, grid: moteslam.Raster, update: moteslam.Update, ends: np.ndarray) -> None:
    """The map with the scan in it, and the particles from close by; an arrow a particle, darker the more it weighs."""
    (x, y, _), poses, weights = update.pose, update.poses, update.weights
    for axes in (plan, near):
        axes.clear()
        grey = np.where(grid.values > 0, 0.15, np.where(grid.values < 0, 1.0, 0.85))
        axes.imshow(grey, origin="lower", extent=grid.extent, cmap="gray", vmin=0, vmax=1)
        axes.set(xlabel="x [m]", facecolor="0.85")
    plan.plot(*ends.T, ".", color="tab:orange", markersize=2)
    plan.plot(x, y, "o", color="tab:blue")
    plan.set(xlim=(-4.5, 7), ylim=(-8, 3), ylabel="y [m]", title="the map, and the scan in it")
    toward = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    look = {"cmap": "Blues", "clim": (0, weights.max()), "scale": 12, "edgecolor": "0.4", "linewidth": 0.3}
    near.quiver(*poses[:, :2].T, *toward, weights, **look)
    near.set(xlim=(x - 0.15, x + 0.15), ylim=(y - 0.15, y + 0.15), ylabel="y [m]")
    near.set_title(f"{update.n_eff:.0f} of 100{' effective: drawn anew' if update.resampled else ' effective'}")


def main(folder: Path = Path()) -> float:
    """Film the drive, and return the smallest effective number of particles."""
    folder.mkdir(parents=True, exist_ok=True)
    drive = moteslam.simulate(moteslam.load_scenario("corridor").with_(duration=SECONDS), seed=0)
    lidar, mount = drive.recording.lidar, drive.recording.platform.lidar.pose
    config = moteslam.resolve_config("paper", SETTINGS)
    slam = moteslam.OnlineSlam.over(drive.recording, config)
    figure, (plan, near) = plt.subplots(1, 2, figsize=(7, 3.6), layout="constrained")
    film, fewest = PillowWriter(fps=4), []
    with film.saving(figure, folder / "particles_film.gif", dpi=120):
        for update in slam:
            if update.updated:
                fewest.append(update.n_eff)
                if len(fewest) % EVERY == 0:
                    draw(plan, near, slam.map, update, endpoints(lidar, mount, update))
                    figure.suptitle(f"{update.stamp - lidar.stamps[0]:.1f} s")
                    film.grab_frame()
    plt.close(figure)
    print(f"down to {min(fewest):.0f} effective particles of 100")
    return float(min(fewest))


if __name__ == "__main__":
    script(main)
