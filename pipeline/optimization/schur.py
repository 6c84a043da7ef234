"""Reduced camera system of bundle adjustment (Schur complement of the points), and its banded solve.

A film's cameras share points with their neighbours and, where it comes back, with a few others. Set in the right order
(reverse Cuthill-McKee), what couples them lies in a band beside the diagonal, so that solving for all of them together
grows with their number and the band's width squared, not with the number cubed.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.sparse import csr_array, identity, triu
from scipy.sparse.csgraph import reverse_cuthill_mckee

from haustra.core.se3 import Array
from pipeline.optimization.kernels import products

ROWS = 32  # cameras multiplied at once
FEW = 20_000  # observations that are not worth a second thread
THREADS = 2  # the kernels let go of the interpreter; each row's sums are one thread's
NARROW = 1 / 3  # band's share of the matrix up to which it pays; the full solver has the better BLAS


@dataclass(frozen=True)
class Coupling:
    """Which cameras share points: what the product of the cross blocks with themselves looks like, whatever is in them.

    Of observations sorted by camera: `camera` and `point` (M,), `starts` (C+1,) where each camera begins; `by_point`
    (M,) the same sorted by point, `begins` (P+1,) where each point begins. The blocks of the product that are not zero,
    on the diagonal and right of it: `column` (K,), `firsts` (C+1,) where each row begins.
    """

    camera: NDArray[np.int64]
    point: NDArray[np.int64]
    starts: NDArray[np.int64]
    by_point: NDArray[np.int64]
    begins: NDArray[np.int64]
    column: NDArray[np.int64]
    firsts: NDArray[np.int64]

    @staticmethod
    def of(camera: NDArray[np.int64], point: NDArray[np.int64], cameras: int, points: int) -> "Coupling":
        starts = np.searchsorted(camera, np.arange(cameras + 1))
        begins = np.concatenate([[0], np.cumsum(np.bincount(point, minlength=points))])
        sees = csr_array((np.ones(len(point), np.int32), point, starts), shape=(cameras, points))
        shared = triu(sees @ sees.T + identity(cameras, np.int32), format="csr")
        shared.sort_indices()
        return Coupling(
            camera, point, starts, np.argsort(point, kind="stable"), begins,
            shared.indices.astype(np.int64), shared.indptr.astype(np.int64),
        )  # fmt: skip


def check_sorted(camera: NDArray[np.int64], point: NDArray[np.int64], cameras: int, points: int) -> None:
    """Of observations (M,) each: raise `ValueError` where the kernels, which check no index, would leave an array."""
    inside = (camera >= 0).all() and (camera < cameras).all() and (point >= 0).all() and (point < points).all()
    if not inside or (np.diff(camera) < 0).any():
        raise ValueError("observations must be sorted by camera, and name cameras and points that there are")


@dataclass(frozen=True)
class Symmetric:
    """A symmetric matrix of 6x6 blocks: diagonal (C,6,6), and blocks (K,6,6) right of it, each once, at row (K,) <
    column (K,); those not named are zero."""

    diagonal: Array
    blocks: Array
    row: NDArray[np.int64]
    column: NDArray[np.int64]

    @staticmethod
    def of(blocks: Array, row: NDArray[np.int64], column: NDArray[np.int64], cameras: int) -> "Symmetric":
        """Of blocks on the diagonal and right of it; any below it are left out."""
        diagonal, on, right = np.zeros((cameras, 6, 6)), row == column, row < column
        diagonal[row[on]] = blocks[on]
        return Symmetric(diagonal, blocks[right], row[right], column[right])

    def subtracted_from(self, diagonal: Array) -> "Symmetric":
        """A matrix that has blocks (C,6,6) on its diagonal alone, less this one."""
        return replace(self, diagonal=diagonal - self.diagonal, blocks=-self.blocks)

    def among(self, chosen: NDArray[np.int64]) -> "Symmetric":
        """The rows and columns `chosen` (C',), ascending, alone."""
        place = np.full(len(self.diagonal), -1)
        place[chosen] = np.arange(len(chosen))
        mine = (place[self.row] >= 0) & (place[self.column] >= 0)
        return Symmetric(self.diagonal[chosen], self.blocks[mine], place[self.row[mine]], place[self.column[mine]])

    def full(self) -> Array:
        """(6C,6C)."""
        count = len(self.diagonal)
        matrix = np.zeros((count, 6, count, 6))
        matrix[np.arange(count), :, np.arange(count)] = self.diagonal
        matrix[self.row, :, self.column] = self.blocks
        matrix[self.column, :, self.row] = self.blocks.transpose(0, 2, 1)
        return matrix.reshape(6 * count, -1)

    def ordered(self) -> NDArray[np.int64]:
        """(C,) the place of each row that brings what couples them close to the diagonal."""
        count = len(self.diagonal)
        pattern = csr_array((np.ones(len(self.row)), (self.row, self.column)), shape=(count, count))
        place = np.empty(count, np.int64)
        place[reverse_cuthill_mckee(csr_array(pattern + pattern.T), symmetric_mode=True)] = np.arange(count)
        return place

    def band(self, place: NDArray[np.int64], width: int) -> Array:
        """(6 width + 6, 6C) the lower half as LAPACK's banded solver takes it, rows at their new places; `width`: how
        far from the diagonal the farthest block lies."""
        height, row, column = 6 * width + 6, place[self.row], place[self.column]
        blocks = np.where((row > column)[:, None, None], self.blocks.transpose(0, 2, 1), self.blocks)
        left, right = 6 * np.minimum(row, column), 6 * np.maximum(row, column)
        flat = np.zeros(height * 6 * len(place))
        for one in range(6):
            for other in range(6):
                flat[height * (left + one) + right + other - left - one] = blocks[:, one, other]
                if other >= one:
                    flat[height * (6 * place + one) + other - one] = self.diagonal[:, one, other]
        return flat.reshape(-1, height).T


def gram(half: Array, coupling: Coupling) -> Symmetric:
    """The product of a (6C,3P) matrix with its own transpose; half: its blocks transposed, (M,3,6)."""
    of, count = coupling, len(coupling.starts) - 1
    blocks = np.zeros((len(of.column), 6, 6))

    def rows(begin: int) -> None:
        end = min(begin + ROWS, count)
        products(half, of.camera, of.point, of.starts, of.by_point, of.begins, of.column, of.firsts, begin, end, blocks)

    if len(of.camera) < FEW:
        for begin in range(0, count, ROWS):
            rows(begin)
    else:
        with ThreadPoolExecutor(THREADS) as threads:
            list(threads.map(rows, range(0, count, ROWS)))
    return Symmetric.of(blocks, np.repeat(np.arange(count), np.diff(of.firsts)), of.column, count)


def solve(matrix: Symmetric, side: Array) -> Array | None:
    """(C,6) x where matrix @ x = side (C,6); None if the matrix is not positive definite."""
    place = matrix.ordered()
    width = int(np.abs(place[matrix.row] - place[matrix.column]).max(initial=0))
    try:
        if width > NARROW * len(place):
            factor = cho_factor(matrix.full(), overwrite_a=True, check_finite=False)
            return cho_solve(factor, side.ravel(), check_finite=False).reshape(-1, 6)
        band = cholesky_banded(matrix.band(place, width), overwrite_ab=True, lower=True, check_finite=False)
    except LinAlgError:
        return None
    there = np.empty_like(side)
    there[place] = side
    return cho_solve_banded((band, True), there.ravel(), check_finite=False).reshape(-1, 6)[place]
