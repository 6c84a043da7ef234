"""PCD of the Point Cloud Library, binary: the vertices with normal, colour and confidence, without triangles."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from reconstruction.mesh.surface_mesh import SurfaceMesh

FIELDS = ("x", "y", "z", "normal_x", "normal_y", "normal_z", "rgb", "confidence")


def write_pcd(mesh: SurfaceMesh, path: Path) -> None:
    """pointclouds.org/documentation/tutorials/pcd_file_format.html; rgb is red, green and blue in one number."""
    count = len(mesh.vertices)
    table = np.zeros(count, [(name, "<u4" if name == "rgb" else "<f4") for name in FIELDS])
    for place, axis in enumerate("xyz"):
        table[axis], table[f"normal_{axis}"] = mesh.vertices[:, place], mesh.normals[:, place]
    red, green, blue = mesh.colours.astype(np.uint32).T
    table["rgb"], table["confidence"] = red << 16 | green << 8 | blue, mesh.confidence
    kinds = " ".join("U" if name == "rgb" else "F" for name in FIELDS)
    header = [
        "# .PCD v0.7 - Point Cloud Data file format",
        "VERSION 0.7",
        "FIELDS " + " ".join(FIELDS),
        "SIZE " + " ".join("4" for _ in FIELDS),
        f"TYPE {kinds}",
        "COUNT " + " ".join("1" for _ in FIELDS),
        f"WIDTH {count}",
        "HEIGHT 1",
        "VIEWPOINT 0 0 0 1 0 0 0",
        f"POINTS {count}",
        "DATA binary",
    ]
    path.write_bytes(("\n".join(header) + "\n").encode("ascii") + table.tobytes())
