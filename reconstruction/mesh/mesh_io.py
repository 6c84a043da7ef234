"""Meshes in and out of files: PLY with everything, GLB and OBJ with colour, STL with the shape alone."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
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


def write_mesh(mesh: SurfaceMesh, path: Path | str) -> Path:
    """Write by suffix; coordinates stay in the mesh's own unit in all four.

    .ply  binary: colour, normal, confidence and observations per vertex
    .glb  colour and normal per vertex; the format means metres, so a viewer shows a millimetre as a metre
    .obj  colour per vertex (`v x y z r g b`, read by MeshLab, Blender and Open3D though not in the standard)
    .stl  triangles only
    """
    path = Path(path)
    if path.suffix.lower() not in WRITERS:
        raise ReconstructionError(f"{path.name}: meshes are written as {', '.join(WRITERS)}")
    if not len(mesh.faces) and path.suffix.lower() != ".ply":
        raise ReconstructionError(f"{path.name}: a mesh without faces can be written as .ply only")
    WRITERS[path.suffix.lower()](mesh, path)
    return path


def read_mesh(path: Path | str) -> SurfaceMesh:
    """Read any of the four; what the file does not hold is filled in as `SurfaceMesh.from_triangles` says."""
    loaded = _load(Path(path))
    held = _ply_element(loaded, "vertex")
    colours = np.asarray(loaded.visual.vertex_colors)[:, :3] if loaded.visual.kind == "vertex" else None
    if colours is not None and Path(path).suffix.lower() == ".glb":
        colours = _srgb_from_linear(colours)
    return SurfaceMesh.from_triangles(
        loaded.vertices,
        loaded.faces,
        colours=colours,
        normals=np.column_stack([held[axis] for axis in ("nx", "ny", "nz")]) if "nx" in held else None,
        confidence=held.get("confidence"),
        observations=held.get("observations"),
    )


def read_face_property(path: Path | str, name: str) -> NDArray | None:
    """A scalar property of a PLY file's faces, (F,); None where the file has no such property."""
    values = _ply_element(_load(Path(path)), "face").get(name)
    return None if values is None else values.reshape(-1)


def _load(path: Path) -> Any:
    import trimesh

    if path.suffix.lower() not in WRITERS:
        raise ReconstructionError(f"{path.name}: meshes are read from {', '.join(WRITERS)}")
    if not path.is_file():
        raise ReconstructionError(f"there is no mesh at {path}")
    try:
        loaded: Any = trimesh.load(path, process=False)
        if isinstance(loaded, trimesh.Scene):  # a GLB, or no geometry at all
            loaded = trimesh.load(path, process=False, force="mesh")
    except (ValueError, KeyError, IndexError, TypeError, NotImplementedError) as error:
        raise ReconstructionError(f"{path} cannot be read as a mesh ({error})") from error
    if not hasattr(loaded, "faces"):
        raise ReconstructionError(f"{path} has points but no faces")
    if path.suffix.lower() == ".stl":
        loaded.merge_vertices()  # the format repeats every corner
    return loaded


def _ply_element(loaded: Any, element: str) -> dict[str, NDArray]:
    """Properties of a PLY file's vertices or faces as it held them; empty for the other formats."""
    data = loaded.metadata.get("_ply_raw", {}).get(element, {}).get("data", {})
    return {name: data[name] for name in (data if isinstance(data, dict) else data.dtype.names)}


def _write_ply(mesh: SurfaceMesh, path: Path) -> None:
    vertices = np.empty(len(mesh.vertices), PLY_VERTEX)
    for place, axis in enumerate("xyz"):
        vertices[axis], vertices[f"n{axis}"] = mesh.vertices[:, place], mesh.normals[:, place]
    vertices["red"], vertices["green"], vertices["blue"] = mesh.colours.T
    vertices["confidence"], vertices["observations"] = mesh.confidence, mesh.observations
    faces = np.empty(len(mesh.faces), PLY_FACE)
    faces["count"], faces["vertex_indices"] = 3, mesh.faces
    properties = [f"property {PLY_NAME[PLY_VERTEX[name].str]} {name}" for name in PLY_VERTEX.names or ()]
    header = [
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *properties,
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    ]
    with path.open("wb") as file:
        file.write(("\n".join(header) + "\n").encode("ascii"))
        file.write(vertices.tobytes())
        file.write(faces.tobytes())


def _write_glb(mesh: SurfaceMesh, path: Path) -> None:
    # glTF 2.0, section 3.7.2.1: COLOR_0 is linear; written as sRGB it looks washed out in every viewer.
    _as_trimesh(mesh, _linear_from_srgb(mesh.colours)).export(path, include_normals=True)


def _write_obj(mesh: SurfaceMesh, path: Path) -> None:
    _as_trimesh(mesh, mesh.colours).export(path, include_normals=True)


def _write_stl(mesh: SurfaceMesh, path: Path) -> None:
    _as_trimesh(mesh, mesh.colours).export(path)


def _as_trimesh(mesh: SurfaceMesh, colours: NDArray[np.uint8]) -> Any:
    import trimesh

    return trimesh.Trimesh(mesh.vertices, mesh.faces, vertex_normals=mesh.normals, vertex_colors=colours, process=False)


def _linear_from_srgb(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """IEC 61966-2-1."""
    value = colours / 255
    linear = np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)
    return np.rint(255 * linear).astype(np.uint8)


def _srgb_from_linear(colours: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """The inverse, to the rounding of eight bits."""
    value = colours / 255
    srgb = np.where(value <= 0.0031308, 12.92 * value, 1.055 * value ** (1 / 2.4) - 0.055)
    return np.rint(255 * srgb).astype(np.uint8)


WRITERS: dict[str, Callable[[SurfaceMesh, Path], None]] = {
    ".ply": _write_ply,
    ".glb": _write_glb,
    ".obj": _write_obj,
    ".stl": _write_stl,
}
