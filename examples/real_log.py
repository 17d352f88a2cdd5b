"""A log of a real robot (CARMEN, CSV, a bag) to a map and a path.

    python examples/real_log.py [FOLDER [LOG]]

Without a log it writes one: CSV files of a simulated drive, as you may write them of your robot.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import moteslam
from moteslam.eval.cli.main import script


def written(folder: Path) -> Path:
    """A log as CSV files."""
    simulation = moteslam.simulate(moteslam.load_scenario("office").with_(duration=60.0), seed=0)
    path = folder / "log.toml"
    moteslam.write_csv(path, simulation.recording)
    return path


def main(folder: Path = Path(), log: Path | None = None) -> float:
    """Read, check, run SLAM, draw, write what other programs read; return the length of the path [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    recording = moteslam.open_recording(log or written(folder))
    print(recording)
    for problem in moteslam.inspect_recording(recording).problems:
        print("problem:", problem.message)
    found = moteslam.run_slam(recording)
    for warning in found.warnings:
        print("warning:", warning.message)

    figure, axes = plt.subplots(figsize=(9, 6), layout="constrained")
    axes.use_sticky_edges = False  # a little room around the map
    moteslam.draw_map(axes, found.map)
    axes.plot(*found.dead_reckoning.poses[:, :2].T, color="tab:orange", linewidth=1, label="dead reckoning")
    axes.plot(*found.trajectory_final.poses[:, :2].T, color="tab:blue", label="SLAM (final)")
    axes.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    figure.legend(loc="outside lower center", ncols=2)
    figure.savefig(folder / "real_log.png", dpi=100)
    plt.close(figure)
    moteslam.write_results(folder / "result", found, figures=False)  # map.pgm, trajectory.tum and more
    print(f"{found.trajectory_final.length:.1f} m")
    return found.trajectory_final.length


if __name__ == "__main__":
    script(main)
