"""Means over seeds and meshes, and how far they are known: a bootstrap that draws both again."""

from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

DRAWS = 10_000
COVERED = 0.95
Table = NDArray[np.float64]  # (seeds, meshes): mean over a mesh's frames


@dataclass(frozen=True)
class Interval:
    """A figure and the interval that covers 95 % of its bootstrap draws."""

    value: float
    low: float
    high: float

    def __neg__(self) -> "Interval":
        return Interval(-self.value, -self.high, -self.low)

    def word(self, claimed: float) -> str:
        """What it says of a reduction that the paper claims, both fractions; a negative one is an increase."""
        if claimed < 0:
            return (-self).word(-claimed)
        low, high = self.low, self.high
        if low <= 0:
            return "not reproduced" if high < claimed / 2 else "not decided"
        if high < claimed / 2:
            return "in sign, less than half"
        return "reproduced" if low <= claimed <= high else "in sign, larger" if low > claimed else "in sign, smaller"

    def sign(self, claimed: float) -> str:
        """Whether it has the sign of a claimed reduction."""
        turned = self if claimed >= 0 else -self
        return "in sign" if turned.low > 0 else "not in sign" if turned.high < 0 else "not decided"

    @property
    def finding(self) -> str:
        """What it says of a sentence that claims it to be above zero."""
        return "reproduced" if self.low > 0 else "not reproduced" if self.high < 0 else "not decided"


def by_mesh(values: list[float], meshes: list[int]) -> NDArray[np.float64]:
    """Mean of a figure over each mesh's frames, (M,), meshes by number."""
    labels = np.array(meshes)
    return np.array([np.mean(np.array(values)[labels == mesh]) for mesh in np.unique(labels)])


def mean_interval(table: Table) -> Interval:
    """The mean of all entries; seeds and meshes are drawn with replacement, each by itself."""
    seeds, meshes = _draws(table.shape)
    return _interval(float(table.mean()), _means(table, seeds, meshes))


def reduction_interval(table: Table, beside: Table) -> Interval:
    """1 - mean of `table` / mean of `beside`, both (S,M) of the same seeds and meshes, which are drawn in pairs."""
    if table.shape != beside.shape:
        raise ValueError(f"tables of the same seeds and meshes have one shape, not {table.shape} and {beside.shape}")
    return _interval(*_reduction(table, beside))


def apart_interval(table: Table, other: Table) -> Interval:
    """Mean of `table` less that of `other`, of other meshes: seeds and meshes of each are drawn by themselves."""
    drawn = _means(table, *_draws(table.shape)) - _means(other, *_draws(other.shape, 1))
    return _interval(float(table.mean() - other.mean()), drawn)


def reductions_apart_interval(first: tuple[Table, Table], second: tuple[Table, Table]) -> Interval:
    """The reduction of a pair of tables (see `reduction_interval`) less that of another, of other meshes."""
    (value, drawn), (other, other_drawn) = _reduction(*first), _reduction(*second, 1)
    return _interval(value - other, drawn - other_drawn)


def _reduction(table: Table, beside: Table, stream: int = 0) -> tuple[float, NDArray[np.float64]]:
    """By how much the one mean is below the other, as it is and in each draw of both in pairs."""
    draws = _draws(table.shape, stream)
    return float(1 - table.mean() / beside.mean()), 1 - _means(table, *draws) / _means(beside, *draws)


@cache
def _draws(shape: tuple[int, ...], stream: int = 0) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    rng = np.random.default_rng(stream)
    return rng.integers(shape[0], size=(DRAWS, shape[0])), rng.integers(shape[1], size=(DRAWS, shape[1]))


def _means(table: Table, seeds: NDArray[np.int64], meshes: NDArray[np.int64]) -> NDArray[np.float64]:
    return table[seeds[:, :, None], meshes[:, None, :]].mean(axis=(1, 2))


def _interval(value: float, drawn: NDArray[np.float64]) -> Interval:
    low, high = np.quantile(drawn, [(1 - COVERED) / 2, (1 + COVERED) / 2])
    return Interval(value, float(low), float(high))
