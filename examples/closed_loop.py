"""A controller of your own drives the simulated robot: it keeps 0.6 m from the wall on its left.

    python examples/closed_loop.py [FOLDER]

The controller sees what a robot would: scans. The truth stands apart, for the picture.
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script

WANTED = 0.6  # [m]


def controller(readings: moteslam.Readings) -> tuple[float, float]:
    """A speed [m/s] and a turn rate [rad/s] from the latest scan."""
    ranges, angles = readings.lidar.ranges[-1], readings.lidar.angles
    known = np.isfinite(ranges)
    ahead, between, left = (np.median(ranges[known & (abs(angles - at) < 0.1)]) for at in (0.0, np.pi / 4, np.pi / 2))
    if ahead < 1.2:
        return 0.0, -0.6
    x, y = between * np.sqrt(0.5), between * np.sqrt(0.5) - left  # along the wall
    return 0.5, float(np.clip(np.arctan2(y, x) + 0.7 * (left - WANTED), -0.6, 0.6))


def main(folder: Path = Path()) -> float:
    """Drive, draw, and return how far the robot came [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    simulator = moteslam.Simulator(moteslam.load_scenario("corridor"), seed=0)
    readings, command = [simulator.reset()], (0.0, 0.0)
    while simulator.seconds < 60:
        if len(readings[-1].lidar):
            command = controller(readings[-1])
        readings.append(simulator.step(*command))
    # moteslam.write_recording("drive.toml", simulator.recording(readings)) keeps it, for `moteslam replay`, and
    # moteslam.write_tum("truth.tum", simulator.truth) beside it the truth, which scores that

    truth = simulator.truth
    figure, axes = plt.subplots(figsize=(6, 6), layout="constrained")
    for x0, y0, x1, y1 in simulator.world.segments:
        axes.plot((x0, x1), (y0, y1), color="0.3", linewidth=1)
    axes.plot(*truth.poses[:, :2].T, color="tab:blue", label=f"{truth.length:.0f} m along the wall")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    axes.legend()
    figure.savefig(folder / "closed_loop.png", dpi=100)
    plt.close(figure)
    print(f"{truth.length:.1f} m driven")
    return truth.length


if __name__ == "__main__":
    script(main)
