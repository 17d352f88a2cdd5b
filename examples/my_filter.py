"""A filter of your own from a skeleton, scored beside the others.

    python examples/my_filter.py [FOLDER]

Each scan is laid on the points of the scans before it by ICP (Besl and McKay 1992): one hypothesis, no weights. What a
run asks of a filter is ``step``, and the three attributes that ``step`` keeps up to date.
"""

from pathlib import Path
from typing import Literal

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial import cKDTree

import moteslam
from moteslam.eval.cli.main import script
from moteslam.robot import se2
from moteslam.slam.config import Method
from moteslam.slam.filter.history import History
from moteslam.slam.filter.protocol import FilterDefaults, Step, StepResult
from moteslam.slam.filter.weights import Weights

CELL, REACH, ROUNDS = 0.05, 0.3, 15  # one point a cell [m], farthest partner [m], iterations of ICP
SEEDS = range(2)


class Icp(FilterDefaults):
    """Dead reckoning from scan to scan, corrected by ICP after every 0.2 m or 0.2 rad."""

    best_particle = 0

    def __init__(self, config: moteslam.SlamConfig, seed: int) -> None:
        self.poses, self.weights, self.history = np.zeros((1, 3)), Weights.uniform(1), History()
        self.pose, self.cells = np.zeros(3), {}

    def step(self, step: Step) -> StepResult:
        """Take in a scan's endpoints, ``step.points`` [k, 2] in the robot's frame [m], and the motion since the scan
        before, ``step.motion`` [3] in the robot's frame there: x, y [m], theta [rad].
        """
        self.pose = se2.compose(self.pose, step.motion)
        moved = se2.between(self.poses[0], self.pose)
        update = not self.cells or np.hypot(*moved[:2]) > 0.2 or abs(moved[2]) > 0.2
        if update:
            if self.cells:
                self.pose = self.laid(self.pose, step.points)
            for point in se2.transform_points(self.pose, step.points):
                self.cells.setdefault((int(point[0] // CELL), int(point[1] // CELL)), point)
            self.poses = self.pose[None].copy()
            self.history.append(self.poses)
        return StepResult(self.pose.copy(), step.motion, n_eff=1.0, score=0.0, updated=update, resampled=False)

    def laid(self, pose: np.ndarray, points: np.ndarray) -> np.ndarray:
        """The pose from which the points [k, 2] lie closest to those of the map."""
        cells = np.array(list(self.cells.values()))
        tree = cKDTree(cells)
        for _ in range(ROUNDS):
            ends = se2.transform_points(pose, points)
            distance, nearest = tree.query(ends, distance_upper_bound=REACH)
            near = distance < REACH
            if near.sum() < 10:
                break
            mine, theirs = points[near], cells[nearest[near]]
            a, b = mine - mine.mean(axis=0), theirs - theirs.mean(axis=0)
            theta = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
            pose = np.array((0.0, 0.0, theta))
            pose[:2] = theirs.mean(axis=0) - se2.transform_points(pose, mine.mean(axis=0)[None])[0]
        return pose


class IcpConfig(moteslam.SlamConfig):
    """Its keys."""

    method: Literal["icp"] = "icp"


METHOD = Method(IcpConfig, Icp)  # what an entry point names: then commands know it as --set method=icp


def main(folder: Path = Path()) -> dict[str, float]:
    """Score, draw, and return the median online ATE of each [m]."""
    folder.mkdir(parents=True, exist_ok=True)
    paper = moteslam.resolve_config("paper")
    default = moteslam.resolve_config("default", ["particles=10", "backend.method=none"])
    methods = {"ICP, ours": (paper, Icp), "paper": (paper, None), "default, 10 particles": (default, None)}
    errors = {"odometry": [], **{name: [] for name in methods}}
    for seed in SEEDS:
        drive = moteslam.simulate(moteslam.load_scenario("office").with_(duration=40.0), seed=seed)
        for name, (config, method) in methods.items():
            found = moteslam.run_slam(drive.recording, config, seed, method=method)
            errors[name].append(moteslam.absolute_trajectory_error(found.trajectory, drive.truth).rmse)
        errors["odometry"].append(moteslam.absolute_trajectory_error(found.dead_reckoning, drive.truth).rmse)

    figure, axes = plt.subplots(figsize=(7, 2.6), layout="constrained")
    for row, values in enumerate(errors.values()):
        axes.plot(100 * np.array(values), [row] * len(values), "o", alpha=0.7)
    axes.set(yticks=range(len(errors)), yticklabels=list(errors), xlim=(0, None))
    axes.set(xlabel="ATE of the online path [cm], one point per seed")
    figure.savefig(folder / "my_filter.png", dpi=100)
    plt.close(figure)
    medians = {name: float(np.median(values)) for name, values in errors.items()}
    for name, error in medians.items():
        print(f"{name}: {100 * error:.1f} cm")
    return medians


if __name__ == "__main__":
    script(main)
