"""VTK's XML PolyData for ParaView and 3D Slicer: points, triangles, and all vertex data by name.

docs.vtk.org/en/latest/vtk_file_formats/vtkxml_file_format.html: arrays inline in base64, after their length in bytes.
"""

from __future__ import annotations

import base64
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from reconstruction.mesh.surface_mesh import SurfaceMesh

VTK_NAMES = {"<f4": "Float32", "<f8": "Float64", "<i4": "Int32", "<i8": "Int64", "|u1": "UInt8"}


def write_vtp(mesh: SurfaceMesh, path: Path) -> None:
    """Point data: RGB (uint8), Normals, confidence, observations. Cells are triangles."""
    ends = np.arange(3, 3 * len(mesh.faces) + 1, 3, dtype=np.int64)
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="PolyData" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "<PolyData>",
        f'<Piece NumberOfPoints="{len(mesh.vertices)}" NumberOfPolys="{len(mesh.faces)}">',
        '<PointData Scalars="RGB" Normals="Normals">',
        _array("RGB", mesh.colours),
        _array("Normals", mesh.normals.astype("<f4")),
        _array("confidence", mesh.confidence.astype("<f4")),
        _array("observations", mesh.observations.astype("<i4")),
        "</PointData>",
        "<Points>",
        _array("Points", mesh.vertices.astype("<f8")),
        "</Points>",
        "<Polys>",
        _array("connectivity", mesh.faces.astype("<i8").ravel()),
        _array("offsets", ends),
        "</Polys>",
        "</Piece>",
        "</PolyData>",
        "</VTKFile>",
    ]
    path.write_text("\n".join(lines) + "\n")


def _array(name: str, values: NDArray) -> str:
    data = np.ascontiguousarray(values).tobytes()
    encoded = base64.b64encode(np.uint64(len(data)).tobytes() + data).decode("ascii")
    components = f' NumberOfComponents="{values.shape[1]}"' if values.ndim == 2 else ""
    kind = VTK_NAMES[values.dtype.newbyteorder("<").str if values.dtype.itemsize > 1 else values.dtype.str]
    return f'<DataArray type="{kind}" Name="{name}"{components} format="binary">{encoded}</DataArray>'
