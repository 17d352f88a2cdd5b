"""A weight update of your own in the paper's filter: the score to a power, in place of the score.

    python examples/my_weight_update.py [FOLDER]

The scores of the particles differ by a few per cent, so that as weights they hardly tell them apart: the effective
number of particles stays near their number. To the 20th power they do. (As a key: ``score_exponent``.)
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script
from moteslam.slam.paper.filter import PaperFilter


class Sharper(PaperFilter):
    """The paper's filter with scores to a power."""

    def likelihood(self, scores: np.ndarray) -> Any:
        return (scores / max(scores.max(), 1)) ** 20


def main(folder: Path = Path()) -> float:
    """Run both, draw the effective numbers, and return the median of ours."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = moteslam.load_scenario("corridor").with_(duration=40.0)
    simulation = moteslam.simulate(scenario, seed=0)
    config = moteslam.resolve_config("paper")
    figure, axes = plt.subplots(figsize=(9, 4), layout="constrained")
    for name, method in (("the paper's", PaperFilter), ("scores to the 20th power", Sharper)):
        found = moteslam.run_slam(simulation.recording, config, seed=0, method=method)
        error = moteslam.absolute_trajectory_error(found.trajectory, simulation.truth).rmse
        updated = found.diagnostics["updated"] > 0
        number = found.diagnostics["n_eff"][updated]
        stamps = found.trajectory.stamps[updated] - found.trajectory.stamps[0]
        axes.step(stamps, number, where="post", label=f"{name}: online ATE {100 * error:.1f} cm")
    axes.set(xlabel="time [s]", ylabel="effective number of 100 particles", ylim=(0, 105))
    axes.legend(loc="lower left")
    figure.savefig(folder / "my_weight_update.png", dpi=100)
    plt.close(figure)
    median = float(np.median(number))
    print(f"median effective number {median:.0f} of 100")
    return median


if __name__ == "__main__":
    script(main)
