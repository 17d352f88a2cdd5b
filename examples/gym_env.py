"""An environment of Gymnasium: drive to goals in a building, by the lidar, without touching anything.

    pip install 'gymnasium>=1'; python examples/gym_env.py [FOLDER]

An action is a speed and a turn rate; an observation 36 ranges, and the goal's distance and bearing. The tests run it
where gymnasium is installed.
"""

from pathlib import Path
from typing import Any

import gymnasium as gym
import matplotlib.pyplot as plt
import numpy as np

import moteslam
from moteslam.eval.cli.main import script
from moteslam.robot import se2

BEAMS, REACH, GOAL = 36, 10.0, 0.3  # observed beams, farthest range [m], radius of the goal [m]


class DriveToGoal(gym.Env):
    """Each tenth of a second: -0.05, the way gained [m], +10 at the goal; -10 and the end at a wall."""

    action_space = gym.spaces.Box(np.float32([0.0, -1.0]), np.float32([0.6, 1.0]))
    observation_space = gym.spaces.Box(-REACH, 100.0, (BEAMS + 2,), np.float32)

    def __init__(self, scenario: str = "corridor") -> None:
        self.scenario = moteslam.load_scenario(scenario)
        self.places = np.array(self.scenario.route.waypoints)[1:]

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[np.ndarray, dict]:
        super().reset(seed=seed)
        self.simulator = moteslam.Simulator(self.scenario, seed=int(self.np_random.integers(2**31)))
        self.goals, self.readings = list(self.places), self.simulator.reset()
        self.ranges = np.full(BEAMS, REACH, np.float32)
        return self._observation(), {}

    def step(self, action: np.ndarray) -> tuple[np.ndarray, float, bool, bool, dict]:
        before = self._to_goal()[0]
        for _ in range(round(0.1 / self.simulator.interval)):
            self._look(self.simulator.step(*map(float, action)))
        gained, near = before - self._to_goal()[0], self._to_goal()[0] < GOAL
        if near:
            self.goals.pop(0)
        hit = self._touches()
        done = hit or not self.goals
        return self._observation(), gained - 0.05 + 10.0 * near - 10.0 * hit, done, self.simulator.done, {}

    def _look(self, readings: moteslam.Readings) -> None:
        if len(readings.lidar):
            parts = np.array_split(np.nan_to_num(readings.lidar.ranges[-1], nan=REACH, posinf=REACH), BEAMS)
            self.ranges = np.minimum([part.min() for part in parts], REACH).astype(np.float32)

    def _touches(self) -> bool:
        """Whether a wall comes within 2 cm of the robot's rectangle."""
        inverse, walls = se2.inverse(self.simulator.pose), self.simulator.world.segments
        begin, end = np.moveaxis(se2.transform_points(inverse, walls.reshape(-1, 2)).reshape(-1, 2, 2), 1, 0)
        half = np.array((self.scenario.platform.length, self.scenario.platform.width)) / 2 + 0.02
        along = np.where(begin == end, 1e-12, end - begin)
        enters, leaves = np.sort([(-half - begin) / along, (half - begin) / along], axis=0)
        return bool((enters.max(axis=1, initial=0) <= leaves.min(axis=1, initial=1)).any())

    def _to_goal(self) -> tuple[float, float]:
        if not self.goals:
            return 0.0, 0.0
        x, y, _ = se2.between(self.simulator.pose, np.array((*self.goals[0], 0.0)))
        return float(np.hypot(x, y)), float(np.arctan2(y, x))

    def _observation(self) -> np.ndarray:
        return np.float32([*self.ranges, *self._to_goal()])


def main(folder: Path = Path()) -> float:
    """Drive by a simple rule, draw the way, and return the sum of the rewards."""
    folder.mkdir(parents=True, exist_ok=True)
    env = DriveToGoal()
    observation, _ = env.reset(seed=0)
    total, over = 0.0, False
    while not over and env.simulator.seconds < 30:
        bearing = observation[-1]
        observation, reward, ended, truncated, _ = env.step(np.array((0.5 * (abs(bearing) < 0.4), 2 * bearing)))
        total, over = total + reward, ended or truncated
    figure, axes = plt.subplots(figsize=(6, 5), layout="constrained")
    for x0, y0, x1, y1 in env.simulator.world.segments:
        axes.plot((x0, x1), (y0, y1), color="0.3", linewidth=1)
    axes.plot(*env.simulator.truth.poses[:, :2].T, color="tab:blue")
    axes.plot(*env.places.T, "o", color="tab:orange", fillstyle="none")
    axes.set(aspect="equal", xlim=(-6, 7), ylim=(-9, 3), xlabel="x [m]", ylabel="y [m]", title=f"reward {total:.0f}")
    figure.savefig(folder / "gym_env.png", dpi=100)
    plt.close(figure)
    print(f"reward {total:.1f}")
    return total


if __name__ == "__main__":
    script(main)
