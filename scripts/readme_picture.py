"""The README's picture from a finished run: frame, sparse points, completed depth, surface.

python scripts/readme_picture.py demo_run docs/demo.png
"""

import argparse
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from pipeline.dense import planned_keyframes
from pipeline.frames import load_frames
from pipeline.refinement import refined_keyframes
from pipeline.sparse_depth import SparseDepthMaker
from pipeline.structure import load_structure
from pipeline.surface import load_surfaces
from pipeline.workspace import open_workspace
from reconstruction.pictures import render_mesh


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("run", type=Path)
    parser.add_argument("target", type=Path)
    arguments = parser.parse_args()
    workspace = open_workspace(arguments.run)
    planned = planned_keyframes(load_frames(workspace), load_structure(workspace), workspace)
    part = refined_keyframes(planned, workspace)[0]
    surface = load_surfaces(workspace)[0]
    row = int(part.rows[len(part.rows) // 2])
    keyframe = part.keyframe(row)
    sparse = SparseDepthMaker(part.submap, part.camera, workspace.config.sparse).sparse_depth(row)
    low, high = np.percentile(keyframe.depth[keyframe.depth > 0], [1, 97])
    figure = plt.figure(figsize=(13, 3.3), constrained_layout=True)
    panels = figure.subplots(1, 4, width_ratios=[1, 1, 1, 1.6])
    panels[0].imshow(keyframe.rgb)
    panels[1].imshow(keyframe.rgb // 3)
    panels[1].scatter(*(sparse.pixels - 0.5).T, c=sparse.depth, s=5, cmap="turbo", vmin=low, vmax=high)
    panels[2].imshow(np.where(keyframe.depth > 0, keyframe.depth, np.nan), cmap="turbo", vmin=low, vmax=high)
    panels[3].imshow(render_mesh(surface.mesh, None, 1000, 620, cut_away=True))
    titles = ("video frame", f"{len(sparse.depth)} sparse points", "completed depth", "surface, cut open")
    for panel, title in zip(panels, titles, strict=True):
        panel.set_title(title, fontsize=11)
        panel.set_axis_off()
    for panel in panels[:3]:
        panel.set_xlim(-0.5, keyframe.rgb.shape[1] - 0.5)
        panel.set_ylim(keyframe.rgb.shape[0] - 0.5, -0.5)
    figure.savefig(arguments.target, dpi=110)


if __name__ == "__main__":
    main()
