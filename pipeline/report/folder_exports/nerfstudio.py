"""nerfstudio's data folder: transforms.json, images/, masks/, depth/ and sparse_pc.ply.

docs.nerf.studio/quickstart/data_conventions.html. Its depth is a thousand times the unit of the poses (depth in mm,
poses in m, as it puts that): so are the arrays in depth/.
"""

import io
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pipeline.finished_run import Run
from pipeline.input.frames import write_image, write_png
from pipeline.report.folder_exports.keyframe_views import empty_folder, pinhole_submap, point_colours, views
from pipeline.run_folder.workspace import write_json
from reconstruction.mesh.formats.ply import write_ply
from reconstruction.mesh.surface_mesh import SurfaceMesh

OPENGL_FROM_OPENCV = np.diag([1.0, -1.0, -1.0, 1.0])
DEPTH_PER_UNIT = 1000  # nerfstudio multiplies by its depth_unit_scale_factor, 1e-3


def write_npy(path: Path, array: NDArray[np.float32]) -> None:
    """As `np.save`, whose error of a full disk says neither that nor where."""
    data = io.BytesIO()
    np.save(data, array, allow_pickle=False)
    path.write_bytes(data.getbuffer())


def export_nerfstudio(run: Run, target: Path) -> Path:
    """Write the run's first submap; returns transforms.json."""
    folder, frames, pictures = empty_folder(target), [], {}
    for name in ("images", "masks", "depth"):
        (folder / name).mkdir()
    for view in views(run):
        image, mask, depth = (
            f"{part}/{view.number:06d}.{suffix}"
            for part, suffix in zip(("images", "masks", "depth"), ("jpg", "png", "npy"), strict=True)
        )
        write_image(folder / image, view.rgb)
        write_png(folder / mask, view.mask)
        write_npy(folder / depth, view.depth * np.float32(DEPTH_PER_UNIT))
        matrix = (view.world_from_camera @ OPENGL_FROM_OPENCV).tolist()
        frames.append({"file_path": image, "mask_path": mask, "depth_file_path": depth, "transform_matrix": matrix})
        pictures[view.number] = view.rgb
    submap = pinhole_submap(run)
    cloud = SurfaceMesh.from_triangles(submap.points, [], colours=point_colours(submap, pictures))
    write_ply(cloud, folder / "sparse_pc.ply")
    camera = run.completed_submaps[0].camera
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    lens = {"camera_model": "OPENCV", "fl_x": fx, "fl_y": fy, "cx": cx, "cy": cy, "w": camera.width, "h": camera.height}
    straight = dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0)
    write_json(folder / "transforms.json", lens | straight | {"ply_file_path": "sparse_pc.ply", "frames": frames})
    return folder / "transforms.json"
