"""A submap as a COLMAP model, read by COLMAP in a process of its own."""

import json
import subprocess
import sys

import numpy as np

from haustra.core.camera import Camera
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import Submap, read_submap

CODE = (
    "import cv2, json, pycolmap, sys; m = pycolmap.Reconstruction(sys.argv[1]); c = next(iter(m.cameras.values()));"
    "off = [float(abs(i.project_point(m.points3D[p.point3D_id].xyz) - p.xy).max())"
    " for i in m.images.values() for p in i.points2D];"
    "print(json.dumps([c.model.name, len(off), max(off)]))"
)


def test_a_lens_that_colmap_lacks_is_a_pinhole_there(tmp_path):
    """COLMAP's own projection of the points lands on the pixels that were written."""
    camera = Camera("SCARAMUZZA", 200, 160, (90.0, 101.0, 82.0, -0.6, 0.3, -0.4, 1.0, 0.002, -0.003))
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, 0, 3] = [0, 0.1, 0.2]
    points = np.random.default_rng(0).uniform([-0.7, -0.6, 1], [0.7, 0.6, 2], (20, 3))
    observations = np.array([(frame, point) for frame in range(3) for point in range(20)])
    local = points[observations[:, 1]] - poses[observations[:, 0], :3, 3]
    submap = Submap(np.arange(3), poses, points, np.full(20, 0.3), observations, camera.project(local), camera.params)
    write_model(submap, camera, tmp_path)
    done = subprocess.run([sys.executable, "-c", CODE, str(tmp_path)], capture_output=True, text=True, check=True)
    model, count, off = json.loads(done.stdout.splitlines()[-1])
    assert (model, count) == ("PINHOLE", 60)
    assert off < 1e-3
    read = read_submap(tmp_path)
    assert read.camera_params == camera.params
    assert submap.observations.dtype == read.observations.dtype == np.int32  # of a long film there are millions
    np.testing.assert_array_equal(read.observations, submap.observations)
    np.testing.assert_array_equal(read.pixels, submap.pixels)
