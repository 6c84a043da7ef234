"""C3VD and C3VDv2: `pose.txt`, sixteen numbers a line, in mm.

The data set's page says row-major camera-to-world, but the renderer writes GLM's columns: the translation is in the
last row, and each matrix is transposed (issues 3 and 20 of DurrLab/C3VD). `coverage_mesh.obj` is the wall in mm: a face
whose corners have texture coordinate 1 was seen by some frame, one with 2 by none.
"""

from pathlib import Path

import numpy as np

from completion.data.readers import read_evaluation_frames
from haustra.core.errors import HaustraError
from haustra.core.text import read_text
from pipeline.input.camera_presets import PRESETS
from pipeline.truth.data_set_truth import DataSetTruth, table_of
from reconstruction.evaluation.coverage_metrics import TrueWall
from reconstruction.mesh.surface_mesh import SurfaceMesh


def read_c3vd(folder: Path) -> DataSetTruth | None:
    if not (folder / "pose.txt").is_file():
        return None
    stored = table_of(folder / "pose.txt", 16, ",").reshape(-1, 4, 4)
    if np.abs(stored[:, :3, 3]).max() > 1e-6:
        raise HaustraError(f"{folder / 'pose.txt'} has its translations in the last column; C3VD's are in the last row")
    world_from_camera, wall = np.swapaxes(stored, 1, 2), read_coverage_mesh(folder / "coverage_mesh.obj")
    flat = next(folder.glob("[!.]*_depth.tiff"), None) is not None
    kind = "c3vd" if flat else "c3vdv2"
    if not flat and next(folder.glob("depth/[!.]*_depth.tiff"), None) is None:
        return DataSetTruth(world_from_camera, wall=wall)
    lens = "c3vd" if flat or folder.name.startswith("c0_") else "c3vd-v2"  # c0_: the first C3VD, released again
    depths = (frame.depth for frame in read_evaluation_frames(folder, kind))
    return DataSetTruth(world_from_camera, depths=depths, camera=PRESETS[lens].camera, wall=wall)


def read_coverage_mesh(path: Path) -> TrueWall | None:
    """None where there is no such file. HaustraError where its faces do not say who was seen."""
    if not path.is_file():
        return None
    rows = [line.split() for line in read_text(path).splitlines()]
    corners = [[value.split("/") for value in row[1:]] for row in rows if row[:1] == ["f"]]
    if not corners or any(len(face) != 3 or len(corner) < 2 for face in corners for corner in face):
        raise HaustraError(f"{path} is no coverage mesh of C3VD: triangles v/vt are expected")
    try:
        vertices = np.array([row[1:4] for row in rows if row[:1] == ["v"]], np.float64).reshape(-1, 3)
        faces = np.array([[int(corner[0]) - 1 for corner in face] for face in corners])
    except ValueError as error:
        raise HaustraError(f"{path} is no coverage mesh of C3VD: a vertex or a face is not of numbers") from error
    if faces.min() < 0 or faces.max() >= len(vertices):
        raise HaustraError(f"{path} is no coverage mesh of C3VD: it has {len(vertices)} vertices, and faces of others")
    texture_index = np.array([[corner[1] for corner in face] for face in corners])
    if not np.isin(texture_index, ["1", "2"]).all():
        raise HaustraError(f"{path} is no coverage mesh of C3VD: its texture coordinates are not 1 (seen) and 2")
    return TrueWall(SurfaceMesh.from_triangles(vertices, faces), (texture_index == "1").all(axis=1))
