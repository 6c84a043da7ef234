"""Unrolled map of the lumen's wall: state, region, colour and confidence over arc length and angle."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from reconstruction.coverage.coverage import Coverage
from reconstruction.mesh.surface_mesh import SurfaceMesh

Array = NDArray[np.float64]

NOT_JUDGED, SEEN, MISSED, UNMEASURED = 0, 1, 2, 3  # the last was visible, but is in no mesh
COLUMNS = 120  # cells around; a cell is as long as it is wide at the lumen's median radius
MARGIN = 0.4  # lumen radii shown on either side of the visited stretch
MAX_OFF_LINE = 3.0  # lumen radii from the centreline beyond which a surface is not drawn
# Barycentric sample points of a triangle, one for each third of an edge: closer together than the cells are wide.
SAMPLES = np.array([(4, 1, 1), (1, 4, 1), (1, 1, 4), (3, 3, 0), (3, 0, 3), (0, 3, 3)]) / 6
CHUNK = 20_000  # faces whose sample points are located in one go: some thirty megabytes


@dataclass(frozen=True)
class UnrolledMap:
    """Cells (A,B): A steps of arc length, B steps of angle, clockwise from 12 o'clock."""

    arc_edges: Array  # (A+1,) in the coverage's unit
    angle_edges: Array  # (B+1,) radians
    state: NDArray[np.uint8]  # (A,B) NOT_JUDGED, SEEN, MISSED or UNMEASURED
    region: NDArray[np.int64]  # (A,B) row of `Coverage.regions`, -1 elsewhere
    colour: NDArray[np.uint8]  # (A,B,3) sRGB; 0 in missed and unmeasured cells
    confidence: NDArray[np.float32]  # (A,B) NaN in those cells and where nothing was recorded


def unroll(coverage: Coverage, mesh: SurfaceMesh, listed: int = 0) -> UnrolledMap:
    """Unrolled map of a coverage; `mesh` gives colour and confidence, and must be the one that was measured.

    A cell collects all wall between two arc lengths and two angles, folds with both their sides included. It is missed
    if at least half of the closed wall's area in it is unobserved; a cell without any closed wall (a fold overhangs it)
    takes its nearest neighbour's state. Cells outside the visited stretch are not judged. Of the first `listed`
    regions, one that is the larger part of no cell (it hides beneath a fold) has all cells that it touches marked as
    missed, so that whatever is listed can be found on the map.
    """
    arc_edges = _arc_edges(coverage)
    middle = (arc_edges[1:] + arc_edges[:-1]) / 2
    judged = coverage.is_visited(middle)[:, None] & np.ones(COLUMNS, bool)
    cells, face = _cells_of_faces(coverage, arc_edges)
    missed, unmeasured, filled = _states(coverage, cells, face, judged)
    region = _regions(coverage, cells, face, missed, filled)
    for number in np.setdiff1d(np.arange(listed), region):
        touched = np.zeros(judged.size, bool)
        touched[cells[coverage.region[face] == number]] = True
        region[touched.reshape(judged.shape) & judged] = number
    missed |= region >= 0
    colour, confidence = _paint(mesh, coverage, arc_edges, missed | unmeasured)
    state = np.where(judged, np.where(missed, MISSED, np.where(unmeasured, UNMEASURED, SEEN)), NOT_JUDGED)
    angle_edges = np.linspace(0, 2 * np.pi, COLUMNS + 1)
    return UnrolledMap(arc_edges, angle_edges, state.astype(np.uint8), region, colour, confidence)


def _arc_edges(coverage: Coverage) -> Array:
    """(A+1,) arc lengths from MARGIN before the visited stretch to MARGIN behind it."""
    cell = 2 * np.pi * coverage.radius / COLUMNS
    past = MARGIN * coverage.radius
    end = coverage.stretch[1] + past
    return np.linspace(-past, end, max(1, round((end + past) / cell)) + 1)


def _states(
    coverage: Coverage, cells: NDArray[np.int64], face: NDArray[np.int64], judged: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """Missed and unmeasured cells (A,B), and for each cell the nearest one with closed wall.

    cells, face: (S,) of the closed wall's sample points.
    """
    weight = coverage.closed_wall.areas[face]
    unobserved, unmeasured = coverage.closed_wall.unobserved[face], coverage.closed_wall.unmeasured[face]
    total, unobserved_area, unmeasured_area = (
        np.bincount(cells, weights=w, minlength=judged.size) for w in (weight, weight * unobserved, weight * unmeasured)
    )
    filled = _nearest_known((total > 0).reshape(judged.shape))
    missed = 2 * unobserved_area >= np.maximum(total, 1e-300)
    pale = 2 * unmeasured_area >= np.maximum(total - unobserved_area, 1e-300)  # half of what is observed, or more
    return missed.reshape(judged.shape)[filled] & judged, pale.reshape(judged.shape)[filled] & judged, filled


def _regions(
    coverage: Coverage,
    cells: NDArray[np.int64],
    face: NDArray[np.int64],
    missed: NDArray[np.bool_],
    filled: tuple[NDArray[np.int64], NDArray[np.int64]],
) -> NDArray[np.int64]:
    """(A,B) row of `Coverage.regions` in missed cells, -1 elsewhere; of several regions in a cell the largest."""
    unobserved = coverage.closed_wall.unobserved[face]
    owner = np.full(missed.size, -1)
    order = np.argsort(-coverage.region[face[unobserved]], kind="stable")  # the largest region last, so that it stays
    owner[cells[unobserved][order]] = coverage.region[face[unobserved]][order]
    return np.where(missed, owner.reshape(missed.shape)[filled], -1)


def _cells_of_faces(coverage: Coverage, arc_edges: Array) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Flat cell (S,) and face (S,) of each sample point of the closed wall that lies on the map."""
    found = list(_samples(coverage, coverage.closed_wall.vertices, coverage.closed_wall.faces, arc_edges))
    none = np.zeros(0, np.int64)
    return np.concatenate([none, *(cells for cells, _ in found)]), np.concatenate([none, *(face for _, face in found)])


def _samples(
    coverage: Coverage, vertices: Array, faces: NDArray[np.int64], arc_edges: Array
) -> Iterator[tuple[NDArray[np.int64], NDArray[np.int64]]]:
    """The same of any faces (F,3), in their order, some at a time."""
    for first in range(0, len(faces), CHUNK):
        corners = vertices[faces[first : first + CHUNK]]
        points = np.einsum("sc,fci->fsi", SAMPLES, corners).reshape(-1, 3)
        cells, inside = _cells_of(coverage, points, arc_edges)
        yield cells, first + np.repeat(np.arange(len(corners)), len(SAMPLES))[inside]


def _cells_of(coverage: Coverage, points: Array, arc_edges: Array) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Flat cells (K,) of those points (N,3) that lie on the map, and which those are (N,)."""
    arc, angle, off = coverage.line.locate(points)
    inside = (arc >= arc_edges[0]) & (arc < arc_edges[-1]) & (off < MAX_OFF_LINE * coverage.radius)
    row = ((arc[inside] - arc_edges[0]) / (arc_edges[1] - arc_edges[0])).astype(np.int64)
    column = (angle[inside] / (2 * np.pi) * COLUMNS).astype(np.int64) % COLUMNS
    return np.minimum(row, len(arc_edges) - 2) * COLUMNS + column, inside


def _paint(
    mesh: SurfaceMesh, coverage: Coverage, arc_edges: Array, bare: NDArray[np.bool_]
) -> tuple[NDArray[np.uint8], NDArray[np.float32]]:
    """Mean colour (A,B,3) and confidence (A,B) of the mesh's faces in each cell, 0 and NaN in `bare` cells (A,B).

    A cell without a sample point takes its nearest neighbour's.
    """
    rows = len(arc_edges) - 1
    count, sums = np.zeros(rows * COLUMNS, np.int64), np.zeros((4, rows * COLUMNS))
    of_vertex = np.column_stack([mesh.colours, mesh.confidence])
    for cells, face in _samples(coverage, mesh.vertices, mesh.faces, arc_edges):
        count += np.bincount(cells, minlength=len(count))
        values = of_vertex[mesh.faces[face]].mean(axis=1).astype(np.float64)
        for total, value in zip(sums, values.T, strict=True):
            np.add.at(total, cells, value)
    mean = (sums / np.maximum(count, 1)).T.reshape(rows, COLUMNS, 4)
    mean = mean[_nearest_known((count > 0).reshape(rows, COLUMNS))]
    colour = np.where(bare[..., None], 0, np.rint(mean[..., :3])).astype(np.uint8)
    return colour, np.where(bare, np.nan, mean[..., 3]).astype(np.float32)


def _nearest_known(known: NDArray[np.bool_]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Row and column (A,B) of the nearest known cell to each cell; distances wrap around at 12 o'clock."""
    from scipy.ndimage import distance_transform_edt

    width = known.shape[1]
    row, column = distance_transform_edt(~np.hstack([known] * 3), return_distances=False, return_indices=True)
    return row[:, width : 2 * width], column[:, width : 2 * width] % width
