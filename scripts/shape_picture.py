"""A finished run's surface as shape alone, for films whose pictures may not be passed on: from two sides.

python scripts/shape_picture.py RUN docs/sinus.png
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from pipeline.surface import load_surfaces
from pipeline.workspace import open_workspace
from reconstruction.pictures import render_mesh
from reconstruction.trajectory import read_tum

CLAY = (214, 178, 160)
BACK = 0.6  # of the median distance to the surface: how far behind the first camera the first view stands
ORBIT_DEG = 50.0  # around the surface, upwards, to the second


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("target", type=Path)
    arguments = parser.parse_args()
    workspace = open_workspace(arguments.run)
    mesh = load_surfaces(workspace)[0].mesh
    _, poses = read_tum(workspace.trajectory)
    clay = np.tile(np.array(CLAY, np.uint8), (len(mesh.vertices), 1))
    inner = poses[0].copy()
    inner[:3, 3] -= BACK * np.median(np.linalg.norm(mesh.vertices - inner[:3, 3], axis=1)) * inner[:3, 2]
    turn, centre = np.eye(4), mesh.vertices.mean(axis=0)
    turn[:3, :3] = Rotation.from_rotvec(-np.radians(ORBIT_DEG) * inner[:3, 0]).as_matrix()
    turn[:3, 3] = centre - turn[:3, :3] @ centre
    views = {
        "from behind the first camera": render_mesh(mesh, inner, 800, 620, 60.0, cut_away=True, colours=clay),
        f"{ORBIT_DEG:.0f} degrees from above": render_mesh(mesh, turn @ inner, 800, 620, 60.0, colours=clay),
    }
    figure = plt.figure(figsize=(9, 3.7), constrained_layout=True)
    panels = figure.subplots(1, 2)
    for panel, (title, picture) in zip(panels, views.items(), strict=True):
        panel.imshow(picture)
        panel.set_title(title, fontsize=11)
        panel.set_axis_off()
    figure.savefig(arguments.target, dpi=110)


if __name__ == "__main__":
    main()
