"""Mesh decimation: time and distance from the full mesh, of ours (pyfqmr) and of Open3D's quadric decimation.

    python -m benchmarks.speed decimation RUN/mesh.ply --triangles 60000 --json decimation.json

Distances are of the full mesh's vertices from the reduced surface, in its unit. Each method runs `--runs` times.
"""

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import shown, spread
from reconstruction.mesh.decimation import decimated
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.open3d_import import import_open3d
from reconstruction.mesh.surface_mesh import SurfaceMesh
from reconstruction.mesh.texture_atlas import distance_to_surface


def by_open3d(mesh: SurfaceMesh, triangles: int) -> SurfaceMesh:
    """As this project had it until version 0.3: centred, by quadric errors."""
    o3d = import_open3d()
    middle = mesh.vertices.mean(axis=0)
    whole = o3d.geometry.TriangleMesh(
        o3d.utility.Vector3dVector(mesh.vertices - middle), o3d.utility.Vector3iVector(mesh.faces.astype(np.int32))
    )
    few = whole.simplify_quadric_decimation(triangles)
    return SurfaceMesh.from_triangles(np.asarray(few.vertices) + middle, np.asarray(few.triangles))


METHODS: dict[str, Callable[[SurfaceMesh, int], SurfaceMesh]] = {"pyfqmr": decimated, "Open3D": by_open3d}


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("mesh", type=Path)
    parser.add_argument("--triangles", type=int, default=60_000)
    parser.add_argument("--runs", type=int, default=3)


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Both methods on one mesh."""
    mesh, figures = read_mesh(arguments.mesh), {}
    for name, method in METHODS.items():
        seconds = []
        for _ in range(arguments.runs):
            started = time.perf_counter()
            few = method(mesh, arguments.triangles)
            seconds.append(time.perf_counter() - started)
        off = distance_to_surface(mesh.vertices, few)
        figures[name] = {"seconds": spread(seconds), "faces": len(few.faces)}
        figures[name] |= {"mean": float(off.mean()), "percentile_99": float(np.percentile(off, 99))}
        figures[name]["greatest"] = float(off.max())
        print(
            f"{name:8} {shown(spread(seconds))} s, {len(few.faces)} faces; "
            f"off by {off.mean():.3g}, most {off.max():.3g}"
        )
    return {"mesh": arguments.mesh.name, "faces": len(mesh.faces), "figures": figures}
