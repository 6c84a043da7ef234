"""Meshes in and out of files, by the suffix's row in `MESH_FORMATS`."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import ReconstructionError
from reconstruction.mesh.formats.mesh_format import MeshFormat
from reconstruction.mesh.formats.registry import MESH_FORMATS
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.textured_mesh import TexturedMesh


def write_mesh(mesh: SurfaceMesh, path: Path | str) -> Path:
    """Write a mesh in the format of the path's suffix, coordinates in the mesh's own unit; returns the path."""
    path = Path(path)
    row = _format_of(path, "written as")
    if not len(mesh.faces) and not row.without_faces:
        able = ", ".join(suffix for suffix, other in MESH_FORMATS.items() if other.without_faces)
        raise ReconstructionError(f"{path.name}: a mesh without faces can be written as {able} only")
    with _in_place_of(path) as beside:
        row.write(mesh, beside)
    return path


def check_textured(path: Path) -> None:
    """Raise `ReconstructionError` if the suffix's format holds no texture, before the minutes that making one takes."""
    _textured_writer(path)


def write_textured(mesh: TexturedMesh, path: Path) -> Path:
    """Write a textured mesh in the format of the path's suffix; returns the path."""
    write = _textured_writer(path)
    with _in_place_of(path) as beside:
        write(mesh, beside)
    return path


@contextmanager
def _in_place_of(path: Path) -> Iterator[Path]:
    """A path of the same name to write to: what lies there then replaces `path`, with files beside it such as an OBJ's
    picture, when all is written. A disk that is full leaves what was there before.

    Files beside it must not exist yet unless an export of the same name made them: the user did not name them.
    """
    with TemporaryDirectory(dir=path.parent, prefix=".partial-") as folder:
        yield Path(folder) / path.name
        written = sorted(one.name for one in Path(folder).iterdir())
        taken = [name for name in written if not path.exists() and (path.parent / name).exists()]
        if taken:
            raise ReconstructionError(f"{taken[0]} lies beside {path.name} already; give another name")
        for name in written:
            os.replace(Path(folder) / name, path.parent / name)


def read_mesh(path: Path | str) -> SurfaceMesh:
    """Read a mesh of any format; what the file does not hold is filled in as `SurfaceMesh.from_triangles` says."""
    path = Path(path)
    loaded = _load(path)
    held = _ply_element(loaded, "vertex")
    colours = np.asarray(loaded.visual.vertex_colors)[:, :3] if loaded.visual.kind == "vertex" else None
    to_srgb = MESH_FORMATS[path.suffix.lower()].srgb
    if colours is not None and to_srgb is not None:
        colours = to_srgb(colours)
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
    return _ply_property(path, "face", name)


def read_vertex_property(path: Path | str, name: str) -> NDArray | None:
    """A scalar property of a PLY file's vertices, (V,); None where the file has no such property."""
    return _ply_property(path, "vertex", name)


def _ply_property(path: Path | str, element: str, name: str) -> NDArray | None:
    values = _ply_element(_load(Path(path)), element).get(name)
    return None if values is None else values.reshape(-1)


def _format_of(path: Path, verb: str) -> MeshFormat:
    if path.suffix.lower() not in MESH_FORMATS:
        raise ReconstructionError(f"{path.name}: meshes are {verb} {', '.join(MESH_FORMATS)}")
    return MESH_FORMATS[path.suffix.lower()]


def _textured_writer(path: Path) -> Any:
    row = MESH_FORMATS.get(path.suffix.lower())
    if row is None or row.write_textured is None:
        able = " or ".join(suffix for suffix, other in MESH_FORMATS.items() if other.write_textured is not None)
        raise ReconstructionError(f"{path.name}: a texture goes into {able}")
    return row.write_textured


def _load(path: Path) -> Any:
    """The file as `trimesh.Trimesh`, with corners merged where the format repeats them."""
    import trimesh

    row = _format_of(path, "read from")
    if row.write_only:
        able = ", ".join(suffix for suffix, other in MESH_FORMATS.items() if not other.write_only)
        raise ReconstructionError(f"{path.name}: meshes are read from {able}; {path.suffix} is only written")
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
    if row.repeats_corners:
        loaded.merge_vertices()
    return loaded


def _ply_element(loaded: Any, element: str) -> dict[str, NDArray]:
    """Properties of a PLY file's vertices or faces as it held them; empty for the other formats."""
    data = loaded.metadata.get("_ply_raw", {}).get(element, {}).get("data", {})
    return {name: data[name] for name in (data if isinstance(data, dict) else data.dtype.names)}
