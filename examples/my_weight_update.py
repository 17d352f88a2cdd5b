"""A weight update of your own in the paper's filter: the score to a power, in place of the score.

    python examples/my_weight_update.py [FOLDER]

To the power 0 all particles weigh the same: no scan chooses among them, and the path is several times as far off. The
scores differ by a few per cent, so that the effective number of particles stays near their number; that is enough here.
To the 20th power half as many are effective, and the path of this short drive is no better. On whole drives the 64th is
better (``docs/theory/paper.md``; as a key: ``score_exponent``).
"""

from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script
from moteslam.slam.paper.filter import PaperFilter


class Powered(PaperFilter):
    """The paper's filter with scores to a power."""

    power = 1

    def likelihood(self, scores: np.ndarray) -> Any:
        return (scores / max(scores.max(), 1)) ** self.power


def main(folder: Path = Path()) -> float:
    """Run all three, draw effective numbers and errors, and return how many times as far off equal weights are."""
    folder.mkdir(parents=True, exist_ok=True)
    scenario = moteslam.load_scenario("corridor").with_(duration=40.0)
    simulation = moteslam.simulate(scenario, seed=0)
    config = moteslam.resolve_config("paper")
    figure, (above, below) = plt.subplots(2, figsize=(9, 5), sharex=True, layout="constrained")
    errors = []
    for Powered.power, name in ((0, "equal weights"), (1, "scores, the paper's"), (20, "scores to the 20th power")):
        found = moteslam.run_slam(simulation.recording, config, seed=0, method=Powered)
        laid = moteslam.absolute_trajectory_error(found.trajectory, simulation.truth)
        errors.append(laid.rmse)
        stamps, updated = found.trajectory.stamps - found.trajectory.stamps[0], found.diagnostics["updated"] > 0
        above.step(stamps[updated], found.diagnostics["n_eff"][updated], where="post")
        off = 100 * np.hypot(*(laid.aligned - laid.reference)[:, :2].T)
        below.plot(stamps, off, label=f"{name}: online ATE {100 * laid.rmse:.1f} cm")
        print(f"{name}: online ATE {100 * laid.rmse:.1f} cm")
    above.set(ylabel="effective of 100 particles", ylim=(0, 105))
    below.set(xlabel="time [s]", ylabel="error [cm]", ylim=(0, None))
    below.legend(loc="upper left")
    figure.savefig(folder / "my_weight_update.png", dpi=100)
    plt.close(figure)
    return errors[0] / errors[1]


if __name__ == "__main__":
    script(main)
