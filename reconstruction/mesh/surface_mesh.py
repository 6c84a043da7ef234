"""Triangle mesh of a reconstructed surface, with colour, confidence and observations per vertex."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from haustra.core.errors import ReconstructionError
from haustra.core.sim3 import scale_of

UNCOLOURED = 200  # sRGB grey level of vertices without colour
CHUNK = 200_000  # faces whose edges are held at once: some thirty megabytes


@dataclass(frozen=True)
class SurfaceMesh:
    """Triangles wound counter-clockwise, and normals pointing, towards the side that the cameras were on."""

    vertices: NDArray[np.float64]  # (V,3), mm or scene units
    faces: NDArray[np.int64]  # (F,3) rows of `vertices`
    colours: NDArray[np.uint8]  # (V,3) sRGB
    normals: NDArray[np.float64]  # (V,3) unit length
    confidence: NDArray[np.float32]  # (V,) mean confidence in [0,1]; NaN where it was never recorded
    observations: NDArray[np.int64]  # (V,) frames that saw the surface here; 0 where never recorded

    def __post_init__(self) -> None:
        count = len(self.vertices)
        for name, shape in {"vertices": (3,), "colours": (3,), "normals": (3,)}.items():
            if getattr(self, name).shape != (count, *shape):
                raise ReconstructionError(f"{name} must be ({count},3), not {getattr(self, name).shape}")
        if self.confidence.shape != (count,) or self.observations.shape != (count,):
            raise ReconstructionError(f"confidence and observations must have one value for each of {count} vertices")
        _check_faces(self.faces, count)

    @classmethod
    def from_triangles(
        cls,
        vertices: ArrayLike,
        faces: ArrayLike,
        colours: ArrayLike | None = None,
        normals: ArrayLike | None = None,
        confidence: ArrayLike | None = None,
        observations: ArrayLike | None = None,
    ) -> SurfaceMesh:
        """A mesh of vertices (V,3) and faces (F,3), with defaults: grey, normals of the faces, NaN, 0."""
        points = np.asarray(vertices, np.float64).reshape(-1, 3)
        triangles = np.asarray(faces, np.int64).reshape(-1, 3)
        count = len(points)
        _check_faces(triangles, count)
        return cls(
            vertices=points,
            faces=triangles,
            colours=np.full((count, 3), UNCOLOURED, np.uint8) if colours is None else np.asarray(colours, np.uint8),
            normals=vertex_normals(points, triangles) if normals is None else np.asarray(normals, np.float64),
            confidence=np.full(count, np.nan, np.float32) if confidence is None else np.asarray(confidence, np.float32),
            observations=np.zeros(count, np.int64) if observations is None else np.asarray(observations, np.int64),
        )

    @property
    def face_areas(self) -> NDArray[np.float64]:
        """(F,) in squared units of the vertices."""
        return np.linalg.norm(self.area_vectors, axis=1)

    @property
    def area_vectors(self) -> NDArray[np.float64]:
        """(F,3) along each face's normal, as long as its area."""
        return _doubled_face_vectors(self.vertices, self.faces) / 2

    @property
    def face_normals(self) -> NDArray[np.float64]:
        """(F,3) unit length; zero where a face has no area."""
        vectors = _doubled_face_vectors(self.vertices, self.faces)
        return vectors / np.maximum(np.linalg.norm(vectors, axis=1, keepdims=True), 1e-300)

    def with_faces(self, kept: NDArray[np.bool_]) -> SurfaceMesh:
        """A copy with the faces where `kept` (F,) is true, without vertices that no face uses."""
        faces = self.faces[kept]
        used = np.zeros(len(self.vertices), bool)
        used[faces] = True
        return SurfaceMesh(
            vertices=self.vertices[used],
            faces=(np.cumsum(used) - 1)[faces],
            colours=self.colours[used],
            normals=self.normals[used],
            confidence=self.confidence[used],
            observations=self.observations[used],
        )

    def transformed(self, target_from_mesh: NDArray[np.float64]) -> SurfaceMesh:
        """A copy moved by a Sim(3), given as (4,4) with scale times rotation in its upper left."""
        linear = np.asarray(target_from_mesh, np.float64)[:3, :3]
        scale = float(scale_of(linear))
        if not scale > 0 or not np.allclose(linear @ linear.T, scale**2 * np.eye(3), atol=1e-6 * scale**2):
            raise ReconstructionError(
                "a mesh is moved only by a scale, a rotation and a shift, without mirror or shear"
            )
        return replace(
            self,
            vertices=self.vertices @ linear.T + target_from_mesh[:3, 3],
            normals=self.normals @ (linear / scale).T,
        )


def vertex_normals(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Unit normals (V,3): area-weighted mean of the adjacent faces' normals; zero where there is no area."""
    total = np.zeros_like(vertices)
    face_vectors = _doubled_face_vectors(vertices, faces)
    for corner in range(3):
        np.add.at(total, faces[:, corner], face_vectors)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.divide(total, length, out=np.zeros_like(total), where=length > 0)


@dataclass(frozen=True)
class DroppedComponents:
    """What `drop_small_components` removed; area in squared units of the mesh."""

    components: int
    faces: int
    area: float
    kept_components: int


def drop_small_components(
    mesh: SurfaceMesh, min_fraction: float = 0.0, min_area: float = 0.0
) -> tuple[SurfaceMesh, DroppedComponents]:
    """The mesh without connected components below `min_area`, or below `min_fraction` of the largest one's area."""
    if not len(mesh.faces):
        return mesh, DroppedComponents(0, 0, 0.0, 0)
    component_of_face = connected_faces(mesh.faces)
    area = np.bincount(component_of_face, weights=mesh.face_areas)
    large = area >= max(min_area, min_fraction * area.max())
    kept = large[component_of_face]
    dropped = DroppedComponents(
        components=int((~large).sum()),
        faces=int((~kept).sum()),
        area=float(area[~large].sum()),
        kept_components=int(large.sum()),
    )
    return mesh.with_faces(kept), dropped


def connected_faces(faces: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number (F,) of the connected piece of each face; faces that share a vertex are connected."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    if not len(faces):
        return np.empty(0, np.int64)
    names, compact = np.unique(faces, return_inverse=True)
    compact = compact.reshape(-1, 3)
    start, end = compact[:, :2].ravel(), compact[:, 1:].ravel()
    links = coo_array((np.ones(len(start), np.int8), (start, end)), shape=(len(names), len(names)))
    label = connected_components(links, directed=False)[1]
    return np.unique(label[compact[:, 0]], return_inverse=True)[1].reshape(-1)


def boundary_sides(faces: NDArray[np.int64]) -> NDArray[np.bool_]:
    """(F,3) whether the edge opposite to each corner is a boundary edge, used by this face alone."""
    ends = faces[:, [1, 2, 0]], faces[:, [2, 0, 1]]
    key = (np.minimum(*ends) * (int(faces.max(initial=0)) + 1) + np.maximum(*ends)).ravel()
    del ends
    order = np.argsort(key)
    key = key[order]
    shared = np.zeros(len(key) + 1, bool)  # with the edge before
    shared[1:-1] = key[1:] == key[:-1]
    alone = np.empty(len(key), bool)
    alone[order] = ~(shared[1:] | shared[:-1])
    return alone.reshape(-1, 3)


def _doubled_face_vectors(vertices: NDArray[np.float64], faces: NDArray[np.int64]) -> NDArray[np.float64]:
    """Cross product of two edges of each face (F,3): along its normal, of length twice its area."""
    vectors = np.empty(faces.shape)
    for begin in range(0, len(faces), CHUNK):
        first, second, third = (vertices[faces[begin : begin + CHUNK, corner]] for corner in range(3))
        vectors[begin : begin + CHUNK] = np.cross(second - first, third - first)
    return vectors


def _check_faces(faces: NDArray[np.int64], count: int) -> None:
    """Raise `ReconstructionError` unless faces are (F,3) rows of `count` vertices."""
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise ReconstructionError(f"faces must be (F,3), not {faces.shape}")
    if len(faces) and not 0 <= faces.min() <= faces.max() < count:
        raise ReconstructionError(f"faces name vertices outside 0..{count - 1}")
