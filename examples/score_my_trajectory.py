"""Your trajectory against the truth: two TUM files in, a table and a picture out.

    python examples/score_my_trajectory.py [FOLDER [ESTIMATE.tum TRUTH.tum]]

Without files it makes two: the odometry of a simulated drive, and its truth.
"""

from pathlib import Path

import matplotlib.pyplot as plt

import moteslam
from moteslam.eval.cli.main import script


def files(folder: Path) -> tuple[Path, Path]:
    """An estimate and its truth, as files."""
    simulation = moteslam.simulate(moteslam.load_scenario("corridor").with_(duration=60.0), seed=0)
    estimate, truth = folder / "estimate.tum", folder / "truth.tum"
    moteslam.write_tum(estimate, moteslam.dead_reckon(simulation.recording))
    moteslam.write_tum(truth, simulation.truth)
    return estimate, truth


def main(folder: Path = Path(), given: tuple[Path, Path] | None = None) -> float:
    """Score, draw, print a table (Markdown), and return the ATE [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    estimate, truth = (moteslam.read_trajectory(path) for path in given or files(folder))
    ate = moteslam.absolute_trajectory_error(estimate, truth)
    rows = [("ATE, laid on the truth", ate.rmse)]
    for metres in (1.0, 5.0):
        try:
            error = moteslam.relative_pose_error(estimate, truth, delta=metres, unit="m")
            rows.append((f"RPE over {metres:g} m", error.translation.rmse))
        except moteslam.InputError as why:  # a drive of a few metres
            print(f"left out: {why}\n")
    print("| metric | RMSE [cm] |\n|---|---:|")
    print("\n".join(f"| {name} | {100 * value:.1f} |" for name, value in rows))

    figure, (plan, over_time) = plt.subplots(1, 2, figsize=(11, 4), layout="constrained")
    look = moteslam.PictureStyle()
    plan.plot(*truth.poses[:, :2].T, color=look.truth, lw=5, alpha=0.5, label="truth")  # a band, seen on both sides
    plan.plot(*ate.aligned[:, :2].T, color=look.slam, lw=1.2, label="estimate, laid on it")
    plan.set(aspect="equal", xlabel="x [m]", ylabel="y [m]")
    plan.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=2)
    over_time.plot(ate.stamps - ate.stamps[0], 100 * ate.errors, color=look.slam)
    over_time.set(xlabel="time [s]", ylabel="position error [cm]", ylim=(0, None))
    figure.savefig(folder / "score_my_trajectory.png", dpi=100)
    plt.close(figure)
    return ate.rmse


if __name__ == "__main__":
    script(main)
