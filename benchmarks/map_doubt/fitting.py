"""Logistic regression whose signs physics demands, and the loss of figures on films that had no part in their fit."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PRIOR = 0.3  # pulls the weights of standardised figures to 0: few wrong maps must not make anything certain
LEAST_GAIN = 0.005  # nats a map, by which another figure must lower the loss


def fitted(figures: Array, wrong: Mask) -> tuple[float, Array]:
    """Offset, and weights (K,) of figures (N,K) that grow where a map is wrong, (N,): none is negative."""
    mean, spread = figures.mean(axis=0), figures.std(axis=0) + 1e-9
    scaled = (figures - mean) / spread

    def loss(x: Array) -> tuple[float, Array]:
        z = x[0] + scaled @ x[1:]
        value = np.sum(np.logaddexp(0, z) - wrong * z) + PRIOR * x[1:] @ x[1:]
        off = expit(z) - wrong
        return float(value), np.concatenate([[off.sum()], scaled.T @ off + 2 * PRIOR * x[1:]])

    bounds = [(None, None)] + [(0.0, None)] * figures.shape[1]
    found = minimize(loss, np.zeros(1 + figures.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = found[1:] / spread
    return float(found[0] - weights @ mean), weights


def probabilities_left_out(figures: Array, wrong: Mask, group: Sequence[str]) -> Array:
    """(N,) of each map, by a fit without the maps of its group."""
    groups, found = np.asarray(group), np.full(len(wrong), np.nan)
    for name in np.unique(groups):
        mine = groups == name
        offset, weights = fitted(figures[~mine], wrong[~mine])
        found[mine] = expit(offset + figures[mine] @ weights)
    return found


def log_loss(probability: Array, wrong: Mask) -> float:
    """Mean over maps, nats; ln 2 is what knowing nothing costs."""
    return float(-np.log(np.clip(np.where(wrong, probability, 1 - probability), 1e-6, 1)).mean())


def chosen_figures(figures: dict[str, Array], wrong: Mask, group: Sequence[str]) -> list[tuple[str, float]]:
    """Names in the order in which each lowers the left-out loss most, and the loss with it; those that hardly lower it
    are left out."""
    taken: list[tuple[str, float]] = []
    while len(taken) < len(figures):
        names = [name for name, _ in taken]
        losses = {}
        for name in figures.keys() - set(names):
            columns = np.stack([figures[one] for one in (*names, name)], axis=1)
            losses[name] = log_loss(probabilities_left_out(columns, wrong, group), wrong)
        best = min(losses, key=lambda name: (losses[name], name))
        if taken and losses[best] > taken[-1][1] - LEAST_GAIN:
            break
        taken.append((best, losses[best]))
    return taken
