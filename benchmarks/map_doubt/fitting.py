"""Logistic regression whose signs physics demands, and how its probabilities do on maps that had no part in it."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

Array = NDArray[np.float64]

PRIOR = 0.3  # of the weights, in standard deviations of their figures: pulls towards no opinion


def fitted(figures: Array, wrong: NDArray[np.bool_], weight: Array) -> tuple[float, Array]:
    """Offset, and weights (K,) >= 0 of figures (N,K), each of which grows where a map is wrong. weight (N,): of maps."""
    mean, spread = figures.mean(axis=0), figures.std(axis=0) + 1e-9
    scaled = (figures - mean) / spread

    def loss(x: Array) -> tuple[float, Array]:
        z = x[0] + scaled @ x[1:]
        value = weight @ (np.logaddexp(0, z) - wrong * z) + PRIOR * x[1:] @ x[1:]
        slope = weight * (expit(z) - wrong)
        return float(value), np.concatenate([[slope.sum()], scaled.T @ slope + 2 * PRIOR * x[1:]])

    start = np.zeros(1 + figures.shape[1])
    bounds = [(None, None)] + [(0, None)] * figures.shape[1]
    found = minimize(loss, start, jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = found[1:] / spread
    return float(found[0] - weights @ mean), weights


def left_out(figures: Array, wrong: NDArray[np.bool_], weight: Array, group: Sequence[str]) -> Array:
    """(N,) probability of each map by a fit without the maps of its group."""
    groups, found = np.asarray(group), np.full(len(wrong), np.nan)
    for name in np.unique(groups):
        rest, mine = groups != name, groups == name
        offset, weights = fitted(figures[rest], wrong[rest], weight[rest])
        found[mine] = expit(offset + figures[mine] @ weights)
    return found


def log_loss(probability: Array, wrong: NDArray[np.bool_], weight: Array) -> float:
    """Mean over maps, nats."""
    likely = np.clip(np.where(wrong, probability, 1 - probability), 1e-6, 1)
    return float(-(weight @ np.log(likely)) / weight.sum())


def chosen_figures(
    names: Sequence[str], figures: Array, wrong: NDArray[np.bool_], weight: Array, group: Sequence[str], most: int
) -> list[tuple[str, float]]:
    """Figures in the order in which each lowers the left-out loss most, at most `most`, and that loss."""
    taken: list[int] = []
    found: list[tuple[str, float]] = []
    best = np.inf
    while len(taken) < most:
        losses = {
            k: log_loss(left_out(figures[:, [*taken, k]], wrong, weight, group), wrong, weight)
            for k in range(len(names))
            if k not in taken
        }
        k = min(losses, key=lambda k: losses[k])
        if losses[k] >= best - LEAST_GAIN:
            break
        best = losses[k]
        taken.append(k)
        found.append((names[k], best))
    return found


LEAST_GAIN = 0.003  # nats
