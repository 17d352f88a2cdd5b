"""The gyro's yaw rates, filtered and integrated as they come.

Readings of a gyro that hangs are left out, as if none had come: a driver that repeats the last reading while the robot
drives on would turn the path for ever. Every real gyro's readings differ in their last bits.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from moteslam.robot.recording import nearest_stamp
from moteslam.robot.values import Issue, when
from moteslam.robot.wheel_odometry import gyro_covers
from moteslam.slam.inputs.config import SyncConfig
from moteslam.slam.rows import Rows, summed

Array = NDArray[np.float64]
HANGS = 2.0  # A gyro that turns hangs once it has repeated a yaw rate to the last bit for so long [s]


class LowPass:
    """A causal first-order Butterworth low-pass, settled at the first value.

    The readings are taken to be evenly spaced: stamps jitter more than a sensor does. The rate is the mean one up to
    each reading, so that no output follows from a later reading.

    Args:
        cut_off: [Hz]; 0 filters nothing, and nor does one at or above half the rate.
    """

    def __init__(self, cut_off: float) -> None:
        self._cut_off, self._readings, self._first = cut_off, 0, 0.0
        self._input = self._output = 0.0  # the latest

    def of(self, value: float, stamp: float) -> float:
        """The filtered value of the next reading; stamps rise [s]."""
        if not self._cut_off > 0:
            return value
        self._first = self._first if self._readings else stamp
        elapsed, before, pole = stamp - self._first, self._input, 0.0
        self._input = value
        if elapsed * 2 * self._cut_off < self._readings:
            # the bilinear transform of the analogue filter: y_i = (1 - p) (x_i + x_{i-1}) / 2 + p y_{i-1}
            warped = float(np.tan(np.pi * self._cut_off * elapsed / self._readings))
            pole = (1 - warped) / (1 + warped)
            value = (1 - pole) * (value + before) / 2
        self._readings += 1
        self._output = value + pole * self._output
        return self._output


class Gyro:
    """What it has measured; readings may be forgotten from the beginning on.

    Attributes:
        heard: stamp of the latest reading, of one left out, too [s].
        hung: from when to when it hung [s].
    """

    def __init__(self, config: SyncConfig) -> None:
        self._config, self._low_pass = config, LowPass(config.low_pass_hz)
        self._rows = Rows(3, order="F")  # stamp, yaw rate, heading
        self._rate, self._since = np.nan, -np.inf  # the latest yaw rate as it came, and since when it is the same
        self.heard, self.hung = -np.inf, list[tuple[float, float]]()

    def __len__(self) -> int:
        return len(self._rows)

    def add(self, stamps: Array, rates: Array) -> None:
        """Take in yaw rates [m, 1] [rad/s]."""
        sound = self._sound(stamps, rates[:, 0])
        stamps, rates = stamps[sound], rates[sound, 0]
        if not len(stamps):
            return
        if self._config.low_pass_hz > 0:
            rates = np.array([self._low_pass.of(*each) for each in zip(rates.tolist(), stamps.tolist(), strict=True)])
        last, rate, heading = self._rows.values[-1].tolist() if len(self) else (stamps[0], rates[0], 0.0)
        before, since = np.concatenate(([rate], rates[:-1])), np.concatenate(([last], stamps[:-1]))
        turns = (rates + before) / 2 * (stamps - since)
        self._rows.add(stamps, rates, summed(heading, turns))

    def turns(self, stamps: Array, turn: Array) -> Array:
        """The turns [m] between stamps [m + 1], its own where it measured them, else the wheels' [rad]."""
        known, rate, heading = self._rows.values.T
        covered = gyro_covers(stamps, known)[1:]
        if not covered.any():
            return turn
        if self._config.method == "nearest":
            own = rate[nearest_stamp(known, stamps[1:])] * np.diff(stamps)
        else:
            own = np.diff(np.interp(stamps, known, heading))
        return np.where(covered, own, turn)

    def forget(self, before: float, kept: int) -> None:
        """Forget those of before a stamp [s], but for so many and, until as many have come, all."""
        if len(self) > 2 * kept:
            since = np.searchsorted(self._rows.values[:, 0], before)
            self._rows.keep(max(kept, len(self) - int(since) + 1))

    def _sound(self, stamps: Array, rates: Array) -> NDArray[np.bool_]:
        """Which readings [m] are not of a gyro that hangs; one that reports 0 may be of a robot at rest."""
        changed = np.append(rates[:1] != self._rate, np.diff(rates) != 0)
        since = np.maximum.accumulate(np.where(changed, stamps, self._since))
        hangs = (stamps - since > HANGS) & (rates != 0)
        for begin, end in zip(since[hangs].tolist(), stamps[hangs].tolist(), strict=True):
            if self.hung and self.hung[-1][0] == begin:
                self.hung.pop()
            self.hung.append((begin, end))
        self._rate, self._since, self.heard = rates[-1], since[-1], stamps[-1]
        return np.asarray(~hangs)


def about_hanging(hung: Sequence[tuple[float, float]]) -> tuple[Issue, ...]:
    """That a gyro hung from when to when [s]."""
    text = f"{when([*hung])}: the gyro repeats one yaw rate to the last bit: it hangs; turns from the wheels there"
    return (Issue("no-gyro", text, len(hung)),) if hung else ()
