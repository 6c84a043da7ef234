"""The cameras' part of a bundle adjustment's normal equations: put together from the points' part, and solved.

A film's cameras share points with their neighbours and, where it comes back, with a few others. Set in the right order
(reverse Cuthill-McKee), what couples them lies in a band beside the diagonal, so that solving for all of them together
grows with their number and the band's width squared, not with the number cubed.
"""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import LinAlgError, cho_factor, cho_solve, cho_solve_banded, cholesky_banded
from scipy.linalg.blas import dsyrk
from scipy.sparse import bsr_array, csr_array
from scipy.sparse.csgraph import reverse_cuthill_mckee

from pipeline.odometry.poses import Array

FULL = 1_000_000  # entries of a cross matrix up to which it is multiplied as a full one
ROWS = 32  # cameras multiplied at once
THREADS = 2  # SciPy lets go of the interpreter; the order of the sums is fixed
NARROW = 1 / 3  # band's share of the matrix up to which it pays; the full solver has the better BLAS


@dataclass(frozen=True)
class Blocks:
    """A matrix of (M,6,3) blocks, cameras by points: `point` (M,) columns, `starts` (C+1,) where each camera begins."""

    data: Array
    point: NDArray[np.int64]
    starts: NDArray[np.int64]
    points: int

    @property
    def cameras(self) -> int:
        return len(self.starts) - 1

    def rows(self, begin: int, end: int) -> bsr_array:
        """The rows of some cameras."""
        part = slice(self.starts[begin], self.starts[end])
        shape = (6 * (end - begin), 3 * self.points)
        return bsr_array((self.data[part], self.point[part], self.starts[begin : end + 1] - part.start), shape=shape)


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


def gram(half: Blocks) -> Symmetric:
    """half @ half', which couples the cameras."""
    count = half.cameras
    if 18 * count * half.points <= FULL:  # a window's matrix is so full that BLAS beats the sparse product
        upper = dsyrk(1.0, half.rows(0, count).toarray().T, trans=1)
        row, column = np.triu_indices(count)
        blocks = upper.reshape(count, 6, count, 6)[row, :, column]
        on = row == column
        blocks[on] = np.triu(blocks[on]) + np.triu(blocks[on], 1).transpose(0, 2, 1)
        return Symmetric.of(blocks, row, column, count)
    last = np.zeros(half.points, np.int64)  # camera that sees each point
    np.maximum.at(last, half.point, np.repeat(np.arange(count), np.diff(half.starts)))

    def part(begin: int) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
        end = min(begin + ROWS, count)
        seen = half.point[half.starts[begin] : half.starts[end]]
        until = int(last[seen].max()) + 1 if len(seen) else end
        result = (half.rows(begin, end) @ half.rows(begin, max(until, end)).T).tobsr((6, 6))
        row = np.repeat(np.arange(end - begin), np.diff(result.indptr))
        return result.data, begin + row, begin + result.indices.astype(np.int64)

    with ThreadPoolExecutor(THREADS) as threads:
        parts = list(threads.map(part, range(0, count, ROWS)))
    blocks, row, column = (np.concatenate(of) for of in zip(*parts, strict=True))
    return Symmetric.of(blocks, row, column, count)


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
