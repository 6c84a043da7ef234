"""Logistic regression with weights >= 0, the sign that physics demands, and its loss on films left out of the fit."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

PRIOR = 0.3  # pulls the weights of standardised predictors to 0: few wrong maps must not make anything certain
LEAST_GAIN = 0.005  # nats a map, by which another predictor must lower the loss


def fitted(predictors: Array, wrong: Mask) -> tuple[float, Array]:
    """Offset and weights (K,), none negative. predictors (N,K) grow where a map is wrong; wrong (N,): whether it is."""
    mean, spread = predictors.mean(axis=0), predictors.std(axis=0) + 1e-9
    scaled = (predictors - mean) / spread

    def loss(x: Array) -> tuple[float, Array]:
        z = x[0] + scaled @ x[1:]
        value = np.sum(np.logaddexp(0, z) - wrong * z) + PRIOR * x[1:] @ x[1:]
        off = expit(z) - wrong
        return float(value), np.concatenate([[off.sum()], scaled.T @ off + 2 * PRIOR * x[1:]])

    bounds = [(None, None)] + [(0.0, None)] * predictors.shape[1]
    found = minimize(loss, np.zeros(1 + predictors.shape[1]), jac=True, bounds=bounds, method="L-BFGS-B").x
    weights = found[1:] / spread
    return float(found[0] - weights @ mean), weights


def probabilities_left_out(predictors: Array, wrong: Mask, group: Sequence[str]) -> Array:
    """Probability (N,) that each map is wrong, by a fit without the maps of its group. predictors (N,K); group: N."""
    groups, found = np.asarray(group), np.full(len(wrong), np.nan)
    for name in np.unique(groups):
        mine = groups == name
        offset, weights = fitted(predictors[~mine], wrong[~mine])
        found[mine] = expit(offset + predictors[mine] @ weights)
    return found


def log_loss(probability: Array, wrong: Mask) -> float:
    """Mean over maps, nats; ln 2 is what knowing nothing costs."""
    return float(-np.log(np.clip(np.where(wrong, probability, 1 - probability), 1e-6, 1)).mean())


def chosen_predictors(predictors: dict[str, Array], wrong: Mask, group: Sequence[str]) -> list[tuple[str, float]]:
    """Greedy forward selection: names in the order in which each lowers the left-out loss most, and the loss with it.
    It ends where no other lowers the loss by `LEAST_GAIN`."""
    taken: list[tuple[str, float]] = []
    while len(taken) < len(predictors):
        names = [name for name, _ in taken]
        losses = {}
        for name in predictors.keys() - set(names):
            columns = np.stack([predictors[one] for one in (*names, name)], axis=1)
            losses[name] = log_loss(probabilities_left_out(columns, wrong, group), wrong)
        best = min(losses, key=lambda name: (losses[name], name))
        if taken and losses[best] > taken[-1][1] - LEAST_GAIN:
            break
        taken.append((best, losses[best]))
    return taken
