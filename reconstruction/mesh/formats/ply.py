"""PLY, binary: colour, normal, confidence and observations per vertex."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reconstruction.mesh.surface_mesh import SurfaceMesh

PLY_VERTEX = np.dtype(
    [
        *((axis, "<f4") for axis in ("x", "y", "z", "nx", "ny", "nz")),
        *((channel, "u1") for channel in ("red", "green", "blue")),
        ("confidence", "<f4"),
        ("observations", "<i4"),
    ]
)
PLY_FACE = np.dtype([("count", "u1"), ("vertex_indices", "<i4", (3,))])
PLY_NAME = {"<f4": "float", "|u1": "uchar", "<i4": "int"}  # numpy type -> PLY type


def write_ply(mesh: SurfaceMesh, path: Path, comments: tuple[str, ...] = ()) -> None:
    """Write vertices as PLY_VERTEX and faces as PLY_FACE, little-endian; comments go into the header."""
    vertices = np.empty(len(mesh.vertices), PLY_VERTEX)
    for place, axis in enumerate("xyz"):
        vertices[axis], vertices[f"n{axis}"] = mesh.vertices[:, place], mesh.normals[:, place]
    vertices["red"], vertices["green"], vertices["blue"] = mesh.colours.T
    vertices["confidence"], vertices["observations"] = mesh.confidence, mesh.observations
    faces = np.empty(len(mesh.faces), PLY_FACE)
    faces["count"], faces["vertex_indices"] = 3, mesh.faces
    with path.open("wb") as file:
        file.write(_header(len(vertices), len(faces), comments))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def _header(vertices: int, faces: int, comments: tuple[str, ...]) -> bytes:
    properties = [f"property {PLY_NAME[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()]
    lines = [
        "ply",
        "format binary_little_endian 1.0",
        *(f"comment {text}" for text in comments),
        f"element vertex {vertices}",
        *properties,
        f"element face {faces}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    return ("\n".join(lines) + "\n").encode("ascii")
