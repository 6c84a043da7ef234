"""The README's pictures of a finished run: frame, sparse points, completed depth, surface; or its shape alone.

python scripts/readme_picture.py demo_run docs/pictures/demo.png
python scripts/readme_picture.py sinus_run docs/pictures/sinus.png --shape  # films whose pictures may not be passed on
"""

import argparse
from itertools import islice
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np
from matplotlib.figure import Figure
from scipy.spatial.transform import Rotation

from haustra import Run, open_run
from reconstruction.mesh.rendering import render_mesh

CLAY = (214, 178, 160)
BACK = 0.85  # of the median distance to the surface: how far behind the first camera the first view stands
ORBIT_DEG = 50.0  # around the surface, upwards, to the second


def stages(run: Run) -> Figure:
    """From a frame to the surface."""
    middle = len(run.completed_submaps[0]) // 2
    keyframe = next(islice(run.keyframes(), middle, None))
    sparse = keyframe.sparse
    low, high = np.percentile(keyframe.depth[keyframe.depth > 0], [1, 97])
    figure = plt.figure(figsize=(13, 3.3), constrained_layout=True)
    panels = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.6])
    panels[0].imshow(keyframe.rgb)
    panels[1].imshow(keyframe.rgb // 3)
    panels[1].scatter(*(sparse.pixels - 0.5).T, c=sparse.depth, s=5, cmap="turbo", vmin=low, vmax=high)
    panels[2].imshow(np.where(keyframe.depth > 0, keyframe.depth, np.nan), cmap="turbo", vmin=low, vmax=high)
    panels[3].imshow(render_mesh(run.surfaces[0].mesh, None, 1000, 620, cut_away=True))
    titles = ("video frame", f"{len(sparse.depth)} sparse points", "completed depth", "surface, cut open")
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=11)
        panel.set_axis_off()
    for panel in panels[:3]:
        panel.set_xlim(-0.5, keyframe.rgb.shape[1] - 0.5)
        panel.set_ylim(keyframe.rgb.shape[0] - 0.5, -0.5)
    return figure


def shape(run: Run) -> Figure:
    """The surface without its colours, from two sides."""
    mesh = run.surfaces[0].mesh
    _, world_from_camera = run.trajectory()
    clay = np.tile(np.array(CLAY, np.uint8), (len(mesh.vertices), 1))
    inner = world_from_camera[0].copy()
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
    return figure


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("target", type=Path)
    parser.add_argument("--shape", action="store_true", help="no picture of the film, and no colour of it")
    arguments = parser.parse_args()
    run = open_run(arguments.run)
    figure = shape(run) if arguments.shape else stages(run)
    figure.savefig(arguments.target, dpi=110)


if __name__ == "__main__":
    main()
