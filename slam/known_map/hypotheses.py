"""Hypotheses of one map: places that look alike stay open until scans contradict all but one.

Between two places that look alike the cells of the map alone decide where an endpoint fits a little better, at every
scan anew and always the same way. So they are weighed against each other by what contradicts the map, and resampling
keeps particles of each: by chance none dies out (Thrun, Burgard and Fox 2005, section 4.3.4, variance of the sampler).
"""

import numpy as np
from numpy.typing import NDArray
from scipy.special import logsumexp

from moteslam.robot.se2 import Array
from moteslam.slam.filter.weights import Weights
from moteslam.slam.tsdf.particles import Particles

LEAST = 0.001  # Hypotheses of a smaller probability are given up
CHANGED = 2.0  # Another hypothesis is the best from so many times the probability on: poses do not jump to and fro


def shares(particles: Particles) -> tuple[NDArray[np.int64], Array]:
    """The numbers [h] of the hypotheses, and the weight [h] of each."""
    numbers, which = np.unique(particles.hypotheses, return_inverse=True)
    return numbers, np.bincount(which, particles.weights.values).astype(np.float64)


def within(particles: Particles, log_likelihood: Array) -> Array:
    """Log-likelihoods [N] that change the weights within each hypothesis, and not the hypotheses' own."""
    kept = log_likelihood.copy()
    log = particles.weights.log
    for number in np.unique(particles.hypotheses):
        of = particles.hypotheses == number
        kept[of] -= logsumexp(log[of] + log_likelihood[of]) - logsumexp(log[of])
    return kept


def best_of(particles: Particles, before: int) -> int:
    """The best particle of the best hypothesis; ``before`` is the number of that until now."""
    numbers, weight = shares(particles)
    best = int(weight.argmax())
    last = np.flatnonzero(numbers == before)
    if len(last) and weight[best] < CHANGED * weight[last[0]]:
        best = int(last[0])
    return int(np.where(particles.hypotheses == numbers[best], particles.weights.log, -np.inf).argmax())


def resample(particles: Particles, most: int) -> NDArray[np.int64]:
    """Draw at most so many particles anew, of every hypothesis in proportion to its weight, and one at least.

    Those of less than ``LEAST`` are given up; the others keep their weights. Returns the parents [M].
    """
    numbers, weight = shares(particles)
    numbers, weight = numbers[weight >= LEAST], weight[weight >= LEAST]
    weight = weight / weight.sum()
    parents, logs = [], []
    for number, share in zip(numbers, weight, strict=True):
        of = np.flatnonzero(particles.hypotheses == number)
        count = max(int(most * share), 1)
        inner = np.cumsum(particles.weights.values[of])
        drawn = np.searchsorted(inner / inner[-1], (np.arange(count) + 0.5) / count)
        parents.append(of[drawn])
        logs.append(np.full(count, np.log(share / count)))
    chosen = np.concatenate(parents)
    best = particles.hypotheses[particles.best]
    particles.resample(chosen)
    particles.weights = Weights(np.concatenate(logs))
    particles.best = best_of(particles, int(best))
    return chosen
