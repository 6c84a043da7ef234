"""Offsets of a wall that are smooth in space and time: a deformation graph whose nodes move on cubic B-splines.

A point moves by the mean of the offsets of its NEAREST nodes, weighted by a Gaussian of its distance to them, as in
Sumner et al., "Embedded deformation for shape manipulation", SIGGRAPH 2007, without their rotations. The field is
fitted to what observations of points miss a still map by; it is linear, and zero costs nothing.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import BSpline
from scipy.sparse import csr_array
from scipy.sparse.linalg import LinearOperator, cg
from scipy.spatial import cKDTree

Array = NDArray[np.float64]
NEAREST = 4  # nodes that move a point, and knots that move a node
WIDTH = 0.7  # of the Gaussian, in distances between neighbouring nodes
TAME = 4.0  # median distances from the middle within which nodes lie: badly triangulated points lie anywhere
ITERATIONS, TOLERANCE = 60, 1e-3


@dataclass(frozen=True)
class OffsetField:
    """nodes (N,3) and the distance between neighbours, in the points' unit; knots (K+4,) in seconds."""

    nodes: Array
    spacing: float
    knots: Array

    @property
    def size(self) -> int:
        """Number of coefficients, each an offset (3,): node after node, each with all its times."""
        return len(self.nodes) * (len(self.knots) - NEAREST)

    def node_weights(self, points: Array) -> csr_array:
        """(M,N) share of each node in the motion of points (M,3)."""
        count = min(NEAREST, len(self.nodes))
        distance, nearest = cKDTree(self.nodes).query(points, k=count)
        distance, nearest = distance.reshape(len(points), count), nearest.reshape(len(points), count)
        # Less the nearest one's, so that far points have weights, too.
        weight = np.exp((distance[:, :1] ** 2 - distance**2) / (2 * (WIDTH * self.spacing) ** 2))
        weight /= weight.sum(axis=1, keepdims=True)
        starts = np.arange(len(points) + 1) * count
        return csr_array((weight.ravel(), nearest.ravel(), starts), shape=(len(points), len(self.nodes)))

    def weights(self, points: Array, seconds: Array) -> csr_array:
        """(M, size) of points (M,3) at times (M,): times the coefficients (size, 3) they are offsets (M,3)."""
        last = np.nextafter(self.knots[-1], self.knots[0])
        in_time = csr_array(BSpline.design_matrix(np.clip(seconds, self.knots[0], last), self.knots, NEAREST - 1))
        in_space = self.node_weights(points)
        times = in_time.shape[1]
        value = in_space.data.reshape(len(points), -1, 1) * in_time.data.reshape(len(points), 1, NEAREST)
        column = in_space.indices.reshape(len(points), -1, 1) * times + in_time.indices.reshape(len(points), 1, NEAREST)
        starts = np.arange(len(points) + 1) * (value.shape[1] * NEAREST)
        return csr_array((value.ravel(), column.ravel(), starts), shape=(len(points), self.size))


def make_field(points: Array, seconds: Array, nodes: int, knot_s: float) -> OffsetField:
    """At most so many nodes, spread over points (P,3) by farthest-point sampling, that move on knots `knot_s` seconds
    apart over the span of the times `seconds`."""
    away = np.linalg.norm(points - np.median(points, axis=0), axis=1)
    tame = points[away <= TAME * np.median(away)]
    chosen, distance = [int(np.argmin(np.linalg.norm(tame - np.median(tame, axis=0), axis=1)))], np.inf
    for _ in range(min(nodes, len(tame)) - 1):
        distance = np.minimum(distance, np.linalg.norm(tame - tame[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(distance)))
    graph = tame[chosen]
    apart = cKDTree(graph).query(graph, k=min(2, len(graph)))[0].reshape(len(graph), -1)[:, -1]
    first, last = float(seconds.min()), float(seconds.max())
    inner = np.linspace(first, max(last, first + knot_s), max(2, 1 + round((last - first) / knot_s)))
    knots = np.concatenate([[inner[0]] * (NEAREST - 1), inner, [inner[-1]] * (NEAREST - 1)])
    return OffsetField(graph, max(float(np.median(apart)), 1e-9), knots)


def fit_offsets(weights: csr_array, jacobian: Array, residual: Array, weight: Array, sigma: float) -> Array:
    """Coefficients (size,3) that take residuals (M,2) of observations nearest to zero, under a Gaussian prior.

    weights (M, size) as `OffsetField.weights` gives them; jacobian (M,2,3): of a residual by its point; weight (M,):
    inverse variance of each observation; sigma: of a coefficient, in the points' unit.
    """
    weighted = jacobian * weight[:, None, None]
    blocks = np.einsum("mik,mil->mkl", weighted, jacobian)
    side = -(weights.T @ np.einsum("mik,mi->mk", weighted, residual))

    def apply(flat: Array) -> Array:
        values = flat.reshape(-1, 3)
        pulled = weights.T @ np.einsum("mkl,ml->mk", blocks, weights @ values)
        return (pulled + values / sigma**2).ravel()

    operator = LinearOperator((side.size, side.size), matvec=apply, dtype=np.float64)
    return cg(operator, side.ravel(), rtol=TOLERANCE, maxiter=ITERATIONS)[0].reshape(-1, 3)
