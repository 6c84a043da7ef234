"""The demo clip: a short withdrawal through three haustra, always the same.

python -m haustra.phantom.dataset.demo FOLDER      # the whole RGB-D folder
python -m haustra.phantom.dataset.demo FOLDER --pack pipeline/demo      # and the files that the package ships
"""

from __future__ import annotations

import argparse
import shutil
from pathlib import Path
from typing import Any

import numpy as np
import trimesh

from haustra.phantom.config import (
    AnatomyConfig,
    AppearanceConfig,
    CameraConfig,
    ImagingConfig,
    MotionConfig,
    PhantomConfig,
)
from haustra.phantom.dataset.generate import Progress, generate, write_ply

DEMO = PhantomConfig(
    seed=7,
    anatomy=AnatomyConfig(length_mm=280.0, radius_mm=22.0, fold_depth_mm=7.0),
    appearance=AppearanceConfig(mesh_vessels=0.75, trees_per_cm2=0.05),
    imaging=ImagingConfig(noise=0.004),
    camera=CameraConfig(width=320, height=320, fov_deg=90.1973),  # fx = fy = 159.45 px
    motion=MotionConfig(frames=165, speed_mm=0.48, start=0.6, wobble_mm=4.0, look_deg=10.0),
)
DEMO_CRF = 18  # x264's constant rate factor: a third of a megabyte, no loss of feature tracks


def write_demo(out_folder: Path, progress: Progress | None = None) -> Path:
    """Film the demo clip into `out_folder` as an RGB-D folder; the clip itself is `video.mp4`."""
    return generate(DEMO, out_folder, progress, crf=DEMO_CRF, preset="slow")


def pack_demo(folder: Path, package: Path) -> None:
    """Copy video, camera and path; of the mesh, which is nine tenths of the size, only the faces that were seen."""
    for name in ("video.mp4", "camera.json", "trajectory.txt"):
        shutil.copy(folder / name, package / name)
    mesh: Any = trimesh.load(folder / "mesh.ply", process=False)
    nearest_mm = mesh.metadata["_ply_raw"]["face"]["data"]["nearest_mm"].ravel()
    seen = np.isfinite(nearest_mm)
    used, faces = np.unique(mesh.faces[seen], return_inverse=True)
    write_ply(package / "mesh.ply", mesh.vertices[used], faces.reshape(-1, 3).astype(np.int32), nearest_mm[seen])


def main() -> None:
    parser = argparse.ArgumentParser(description="Film the demo clip.")
    parser.add_argument("folder", type=Path)
    parser.add_argument("--pack", type=Path, help="package folder to copy the clip and its truth to")
    arguments = parser.parse_args()
    write_demo(arguments.folder)
    if arguments.pack:
        pack_demo(arguments.folder, arguments.pack)


if __name__ == "__main__":
    main()
