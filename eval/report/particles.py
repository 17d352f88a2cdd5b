"""The figure of the particles: their deviations and their common ancestors, which show the uncertainty."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from moteslam.errors import File
from moteslam.eval.metrics.association import evenly, travelled
from moteslam.eval.report import style
from moteslam.eval.report.style import STEPS, broken
from moteslam.robot.se2 import Array, between, compose
from moteslam.robot.values import expect_type
from moteslam.slam.estimate import Estimate

PARTICLES_DRAWN, ELLIPSES = 50, 30
"""Of more particles an even choice is drawn; at so many places on the plan, evenly along the path, the spread."""
DRAWN_SIZE = 0.08  # Deviations are magnified to at most this share of the plan's longer side
COMPONENTS = (("along [cm]", 100.0), ("across [cm]", 100.0), ("heading [deg]", 180 / np.pi))
"""Of a deviation: label of its axis, and the factor from m or rad to its unit."""


@dataclass(frozen=True, eq=False)
class Cloud:
    """The particles of a run: stamps [u], paths [K, u, 3], ancestors [K, u] and spread [u, 3] as of ``Estimate``.

    The survivors are those of the last update, whose paths these are; ``best`` is the index of the best one.
    """

    stamps: Array
    paths: Array
    ancestors: NDArray[np.int64]
    spread: Array
    best: int = 0

    @classmethod
    def of(cls, estimate: Estimate) -> Cloud:
        """The particles of an estimate; the best one is where the final trajectory ends."""
        stamps, paths = estimate.particle_stamps, estimate.particle_paths
        from_end = paths[:, -1] - estimate.trajectory_final.at(stamps[-1:]).poses[0]
        best = int(np.hypot(from_end[:, 0], from_end[:, 1]).argmin())
        return cls(stamps, paths, estimate.particle_ancestors, estimate.particle_spread, best)

    @property
    def time(self) -> Array:
        """Of the updates [u], from the first [s]."""
        return np.asarray(self.stamps - self.stamps[0])

    @cached_property
    def mean(self) -> Array:
        x, y = self.paths[..., :2].mean(axis=0).T
        heading = np.arctan2(np.sin(self.paths[..., 2]).mean(axis=0), np.cos(self.paths[..., 2]).mean(axis=0))
        return np.stack((x, y, heading), axis=-1)

    def deviations(self, survivors: NDArray[np.int64]) -> Array:
        """Of survivors [k] from the mean path, [k, u, 3]: along and across its heading [m], of heading [rad]."""
        return between(self.mean, self.paths[survivors])

    @cached_property
    def ancestor_counts(self) -> NDArray[np.int64]:
        """How many particles of every update [u] have survivors among their descendants."""
        ordered = np.sort(self.ancestors, axis=0)
        return np.asarray(1 + np.count_nonzero(np.diff(ordered, axis=0), axis=0))

    @property
    def partings(self) -> NDArray[np.int64]:
        """The updates [p] at which lineages part: the survivors have more ancestors there than one update before."""
        return np.flatnonzero(np.diff(self.ancestor_counts) > 0) + 1


def draw_particles(path: File, cloud: Cloud, *, title: str = "") -> None:
    """The particles' deviations, magnified on the plan and over time, and their ancestors (figure 8 of the paper)."""
    expect_type(cloud, Cloud, "cloud", "Cloud.of(estimate) makes one")
    count = len(cloud.paths)
    drawn = evenly(np.arange(count), PARTICLES_DRAWN)
    with style.saved_figure(path, size=(14.0, 8.5), title=title) as figure:
        grid = figure.add_gridspec(4, 2, width_ratios=(1.0, 1.15))
        plan = figure.add_subplot(grid[:, 0])
        first = figure.add_subplot(grid[0, 1])
        panels = [first, *(figure.add_subplot(grid[row, 1], sharex=first) for row in (1, 2, 3))]
        _draw_plan(plan, cloud, drawn)
        for column, axes in enumerate(panels[:3]):
            _draw_deviations(axes, cloud, drawn, column)
            axes.tick_params(labelbottom=False)
        _draw_ancestors(panels[3], cloud)
        first.set_title("deviation of the last update's particles from their mean path", loc="left")
        panels[3].set_xlabel("time [s]")


def _draw_plan(axes: style.Axes, cloud: Cloud, drawn: NDArray[np.int64]) -> None:
    from matplotlib.collections import EllipseCollection, LineCollection

    mean, deviations = cloud.mean, cloud.deviations(drawn)
    size = float(np.ptp(mean[:, :2], axis=0).max())
    spread = 2 * cloud.spread[:, :2]
    limit = DRAWN_SIZE * size / max(float(abs(deviations[..., :2]).max()), float(np.quantile(spread, 0.9)), 1e-6)
    factor = max(int(step) for step in STEPS if step <= max(limit, 1))
    paths = compose(mean, deviations * (factor, factor, 1.0))
    along = travelled(mean)[0]
    places = np.unique(np.searchsorted(along, np.linspace(0.0, along[-1], ELLIPSES)).clip(max=len(mean) - 1))
    widths, heights = 2 * factor * spread[places].T
    offsets = {"offsets": mean[places, :2], "offset_transform": axes.transData}
    look = {"facecolors": "0.85", "edgecolors": "0.6", "linewidths": 0.5}
    turns = np.rad2deg(mean[places, 2])
    axes.add_collection(EllipseCollection(widths, heights, turns, units="xy", **offsets, **look))
    axes.add_collection(LineCollection(list(paths[..., :2]), colors=style.PARTICLE, linewidths=0.6))
    style.draw_paths(axes, (mean, {"color": "black", "lw": 0.6, "label": "mean path"}), start=mean)
    axes.plot(*mean[cloud.partings, :2].T, "d", color=style.DEAD_RECKONING, ms=5, mew=0)
    title = "deviations, and ellipses of 2 standard deviations"
    axes.set_title(f"{title}, magnified {factor} times" if factor > 1 else title)
    style.plan(axes)
    reach = factor * spread[places].max(axis=1, keepdims=True)
    around = [mean[places, :2] - reach, mean[places, :2] + reach]
    style.show_everything(axes, paths[..., :2], *around, margin=0.03 * size + 0.1)


def _draw_deviations(axes: style.Axes, cloud: Cloud, drawn: NDArray[np.int64], column: int) -> None:
    from matplotlib.collections import LineCollection

    label, unit = COMPONENTS[column]
    values = unit * cloud.deviations(drawn)[..., column]
    best = unit * cloud.deviations(np.array([cloud.best]))[0, :, column]
    time, sigma = broken(cloud.time, unit * cloud.spread[:, column])
    label_of_band = "standard deviation of all particles (ellipses: twice)"
    axes.fill_between(time, -sigma, sigma, facecolor="0.85", edgecolor="0.3", lw=0.6, label=label_of_band)
    for side in (-sigma, sigma):  # over the paths, which may hide the band
        axes.plot(time, side, color="0.3", lw=0.6, zorder=3)
    lines = [np.stack(broken(cloud.time, line), axis=-1) for line in values]
    count = len(cloud.paths)
    survivors = f"paths of {f'{len(drawn)} of ' if len(drawn) < count else ''}{count} particles of the last update"
    axes.add_collection(LineCollection(lines, colors=style.PARTICLE, linewidths=0.6, label=survivors))
    axes.plot(*broken(cloud.time, best), color=style.SLAM, lw=1.0, label="path of the best particle")
    top = max(float(abs(values).max()), float(np.nanquantile(sigma, 0.99)), 1e-3)
    axes.set_ylim(-1.1 * top, 1.1 * top)
    highest = int(np.nanargmax(sigma))
    if sigma[highest] > 1.1 * top:
        most = f"{sigma[highest]:.3g} {label.split('[')[1][:-1]}"
        axes.set_title(f"standard deviation up to {most} at {time[highest]:.0f} s", loc="right")
    style.curve_axes(axes, label)


def _draw_ancestors(axes: style.Axes, cloud: Cloud) -> None:
    counts, partings, count = cloud.ancestor_counts, cloud.partings, len(cloud.paths)
    axes.plot(cloud.time, counts, color="black", lw=1.0, drawstyle="steps-post")
    label = f"lineages part{f' ({len(partings)} times)' * (len(partings) > 1)}"
    axes.plot(cloud.time[partings], counts[partings], "d", color=style.DEAD_RECKONING, ms=5, mew=0, label=label)
    style.log_axis(axes, 0.8, 1.25 * count)
    style.curve_axes(axes, "ancestors")
    single = np.flatnonzero(counts == 1)
    since = f"one common ancestor until {cloud.time[single[-1]]:.0f} s" if len(single) else f"{counts[0]} at the start"
    axes.set_title(f"ancestors of the {count} particles of the last update: {since}", loc="left")
