"""Small spots of a surface that are far too dark for where they lie: lids over the mouths of pouches.

Completed depth closes the dark mouth of a diverticulum with a lid in the plane of the wall, where no point says
otherwise. With the lamp divided out (`photometry`) wall keeps its albedo, but the lid's brightness is that of the
pouch's bottom, which lies farther away and in shadow. Its rounded lip faces the lamp. So a small spot much darker than
the wall around it, with a rim that is brighter, is more likely a mouth than wall. It reaches from its dark middle as
far as the wall stays darker than usual, as Canny follows an edge by two thresholds. Light that the fitted lamp does not
explain fades into the wall around, and has no such rim.

A picture alone does not tell a mouth from a dark patch with a bright rim, as residue or pigment may be. The limits were
chosen on films of a phantom whose mouths all have one model of lip (docs/lab/depth_and_surface.md).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csr_array, eye_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from reconstruction.fusion.photometry import GAMMA, LUMA
from reconstruction.mesh.surface_mesh import SurfaceMesh, boundary_sides

LOG_DARKER = -0.5  # of luminance: the middle of a spot has less than 0.61 of what the wall around it has,
LOG_DARK = -0.3  # and all of it less than 0.74
AVERAGES = 10  # over each vertex and its neighbours: vessels of some voxels vanish, a mouth does not
GRID, AROUND = 4.0, 30.0  # voxels: spacing of the samples of the wall around, and how far it reaches
MIDDLE_VERTICES = 20  # at least, of a spot's middle; a vertex stands for about one square voxel
MIDDLE_SHARE = 0.25  # of a spot, at least: a faint patch with a dark speck in it is no mouth
SPOT_VERTICES = 800  # at most, of all of it
RIM_EDGES = 6  # from a spot to its rim; averages spread a step by some three edges (standard deviation)
RIM_LOG = 0.03  # least mean of the rim, over the wall around
LONGEST_HOLE = 100  # edges around a hole that a lid may have already; longer ones are where the mesh ends
CHUNK = 4000  # samples whose surroundings are held at once: some twenty megabytes
MOST_DARK = 0.03  # share of vertices as dark as a spot's middle beyond which the tissue is uneven, and no spot is found


def dark_spots(mesh: SurfaceMesh, voxel_size: float, gamma: float = GAMMA) -> NDArray[np.bool_]:
    """Vertices (V,) of dark spots. voxel_size: in the mesh's unit; gamma: of its colours, out of which the lamp is."""
    if not len(mesh.faces):
        return np.zeros(len(mesh.vertices), bool)
    links = _links(mesh)
    relative = _relative_luminance(mesh, links, voxel_size, gamma)
    middle, dark = relative < LOG_DARKER, relative < LOG_DARK
    if not middle.any() or middle.mean() > MOST_DARK:
        return np.zeros(len(dark), bool)
    rows = np.flatnonzero(dark)
    spot = np.full(len(dark), -1)
    spot[rows] = connected_components(links[rows][:, rows], directed=False)[1]
    vertices = np.bincount(spot[rows])
    middles = np.bincount(spot[rows], middle[rows])
    holes = (middles >= np.maximum(MIDDLE_VERTICES, MIDDLE_SHARE * vertices)) & (vertices <= SPOT_VERTICES)
    rims, near = _rims(spot, links, relative, len(vertices))
    holes &= rims >= RIM_LOG
    at_end = near[_ends(mesh)]
    holes[at_end[at_end >= 0]] = False
    return dark & holes[spot]


def without_vertices(mesh: SurfaceMesh, gone: NDArray[np.bool_]) -> SurfaceMesh:
    """A copy without the faces that have one of these vertices (V,)."""
    return mesh.with_faces(np.logical_not(gone[mesh.faces].any(axis=1)))


def _relative_luminance(mesh: SurfaceMesh, links: csr_array, voxel_size: float, gamma: float) -> NDArray[np.float64]:
    """Log luminance (V,), averaged along the surface, less its median over the wall around."""
    linear = (np.maximum(mesh.colours, 1) / 255.0) ** gamma
    smooth = np.log(linear @ LUMA)
    here_and_beside = links + eye_array(len(smooth), format="csr")
    count = here_and_beside.sum(axis=1)
    for _ in range(AVERAGES):
        smooth = here_and_beside @ smooth / count
    cells = np.floor(mesh.vertices / (GRID * voxel_size)).astype(np.int64)
    cells -= cells.min(axis=0)
    samples = np.unique(np.ravel_multi_index(tuple(cells.T), tuple(cells.max(axis=0) + 1)), return_index=True)[1]
    tree = cKDTree(mesh.vertices[samples])
    neighbours = min(len(samples), round(np.pi * (AROUND / GRID) ** 2))
    of_samples, around = smooth[samples], np.empty(len(samples))
    for first in range(0, len(samples), CHUNK):
        some = samples[first : first + CHUNK]
        nearest = tree.query(mesh.vertices[some], k=neighbours, workers=-1)[1].reshape(len(some), neighbours)
        around[first : first + CHUNK] = np.median(of_samples[nearest], axis=1)
    return smooth - around[tree.query(mesh.vertices, workers=-1)[1]]


def _rims(
    spot: NDArray[np.int64], links: csr_array, relative: NDArray[np.float64], spots: int
) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """Mean of `relative` (V,) over each spot's vertices `RIM_EDGES` edges away, NaN where there are none; and (V,) the
    spot that a vertex is in or within these edges of, -1 for none.

    spot: (V,) number of a vertex's spot, -1 outside.
    """
    nearest, edges = spot.copy(), links.tocoo()
    rim = np.zeros(0, np.int64)
    for _ in range(RIM_EDGES):
        step = (nearest[edges.row] >= 0) & (nearest[edges.col] < 0)
        rim = np.unique(edges.col[step])
        nearest[edges.col[step]] = nearest[edges.row[step]]
    total, count = (np.bincount(nearest[rim], weights=w, minlength=spots) for w in (relative[rim], None))
    return np.divide(total, count, out=np.full(spots, np.nan), where=count > 0), nearest


def _ends(mesh: SurfaceMesh) -> NDArray[np.int64]:
    """Vertices where the mesh ends: on boundary edges that do not surround a small hole."""
    start, end = mesh.faces[:, [[1, 2], [2, 0], [0, 1]]][boundary_sides(mesh.faces)].T
    along = coo_array((np.ones(len(start)), (start, end)), shape=(len(mesh.vertices),) * 2)
    loop = connected_components(along, directed=False)[1]
    length = np.bincount(loop[start], minlength=loop.max() + 1)
    return np.unique(np.concatenate([start, end])[np.tile(length[loop[start]] > LONGEST_HOLE, 2)])


def _links(mesh: SurfaceMesh) -> csr_array:
    """Adjacency (V,V) of vertices that share an edge."""
    faces = mesh.faces.astype(np.int32)  # of a long film there are millions
    start, end = (faces[:, columns].ravel() for columns in ([0, 1, 2], [1, 2, 0]))
    both = np.concatenate([start, end]), np.concatenate([end, start])
    links = coo_array((np.ones(len(both[0]), np.int8), both), shape=(len(mesh.vertices),) * 2).tocsr()
    links.data[:] = 1
    return links
