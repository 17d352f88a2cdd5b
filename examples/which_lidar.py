"""Which lidar does the robot need? The same drive with three of them.

    python examples/which_lidar.py [FOLDER [SCENARIO]]

``moteslam sweep`` does this over many seeds, with intervals; here is the idea in a loop.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script

LIDARS = {  # beams, reach [m], scans a second, noise of a range [m]
    "like an RPLIDAR A1": (360, 12.0, 5.5, 0.02),
    "like a Hokuyo URG-04LX": (683, 4.0, 10.0, 0.03),
    "like a Hokuyo UTM-30LX": (1081, 30.0, 40.0, 0.01),
}
SEEDS = range(2)


def scenario(name: str, beams: int, reach: float, rate: float, noise: float) -> moteslam.Scenario:
    """A scenario, by its name or file, with a lidar of these figures, 270 degrees wide."""
    step = np.radians(270) / (beams - 1)
    lidar = {"beams": beams, "angle_min": -np.radians(135), "angle_increment": step, "rate": rate, "range_max": reach}
    lidar["time_increment"] = 0.0
    settings = [f"platform.lidar.{key}={value}" for key, value in lidar.items()]
    settings.append(f"noise.lidar.range_noise={noise}")
    return moteslam.load_scenario(name, settings=settings).with_(duration=40.0)


def main(folder: Path = Path(), name: str = "corridor") -> dict[str, float]:
    """Run, draw, and return the median ATE by lidar [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    errors = {lidar: [] for lidar in LIDARS}
    config = moteslam.resolve_config("default", ["particles=5"])
    for lidar, figures in LIDARS.items():
        for seed in SEEDS:
            drive = moteslam.simulate(scenario(name, *figures), seed=seed)
            found = moteslam.run_slam(drive.recording, config, seed=seed)
            errors[lidar].append(moteslam.absolute_trajectory_error(found.trajectory, drive.truth).rmse)

    figure, axes = plt.subplots(figsize=(7, 3), layout="constrained")
    for row, values in enumerate(errors.values()):
        axes.plot(100 * np.array(values), row + 0.1 * np.arange(len(values)), "o", alpha=0.7)
    label = f"online ATE in {name} [cm], one point per seed"
    axes.set(yticks=range(len(errors)), yticklabels=list(errors), xlabel=label, xlim=(0, None))
    figure.savefig(folder / "which_lidar.png", dpi=100)
    plt.close(figure)
    medians = {lidar: float(np.median(values)) for lidar, values in errors.items()}
    for lidar, error in medians.items():
        print(f"{lidar}: {100 * error:.1f} cm")
    return medians


if __name__ == "__main__":
    script(main)
