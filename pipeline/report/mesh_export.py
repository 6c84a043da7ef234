"""A finished run's mesh in another format, with fewer triangles or with its colours as a picture."""

from pathlib import Path

import numpy as np

from pipeline.finished_run import open_run
from pipeline.surface.scale import unit_label
from reconstruction.mesh.mesh_io import check_textured, write_mesh, write_textured
from reconstruction.mesh.texture_atlas import simplified, textured


def export_mesh(run: Path, target: Path, max_error: float | None = None, texture: bool = False) -> str:
    """Write a finished run's mesh in the format of `target`'s suffix and say what was written.

    max_error: largest distance, in the run's unit, of the full mesh from one with fewer triangles. texture: its colours
    as a picture (.glb, .obj) instead of one for each vertex.
    """
    finished = open_run(run)
    if texture:
        check_textured(target)
    mesh, unit = finished.surfaces[0].mesh, unit_label(finished.unit())
    light, error = (mesh, 0.0) if max_error is None else simplified(mesh, max_error)
    if texture:
        write_textured(textured(light, mesh), target)
    else:
        write_mesh(light, target)
    if max_error is None:
        return str(target)
    if light is mesh:
        kept = f"all {len(mesh.faces)} triangles are left"
        return f"{target}: {kept}, since none of half as many was found within {max_error:g} {unit}"
    return f"{target}: {len(light.faces)} of {len(mesh.faces)} triangles, at most {_rounded_up(error)} {unit} off"


def _rounded_up(length: float) -> str:
    """Two digits, never less than the length itself; of a flat mesh it is 0."""
    if not length > 0:
        return "0"
    step = 10.0 ** (np.floor(np.log10(length)) - 1)
    return f"{np.ceil(length / step) * step:.2g}"
