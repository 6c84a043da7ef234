"""A phantom as a folder on disk: video, images, depth, path, mesh and the config that made them.

video.mp4       H.264, what a user would have
rgb/%05d.png    the same frames, lossless
depth/%05d.png  uint16 z-depth in units of 0.01 mm, 0 = none
trajectory.txt  TUM lines "seconds tx ty tz qx qy qz qw", world_from_camera, mm
mesh.ply        the wall, mm; face properties: `seen` is 1 where any frame's pixel centre hit it, `nearest_mm` the
                smallest depth at which one did (infinite where none)
camera.json  polyps.json  config.yaml
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import asdict
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from phantom.config import PhantomConfig
from phantom.motion import camera_path
from phantom.render import Frame, Phantom

DEPTH_UNIT_MM = 0.01  # uint16 then reaches 655 mm
Progress = Callable[[int, int], None]


def generate(
    config: PhantomConfig, folder: Path, progress: Progress | None = None, crf: int = 18, threads: int = 0
) -> Path:
    """Film one phantom into `folder` (made if missing); `progress(done, total)` counts frames.

    `crf` is x264's constant rate factor: 18 looks lossless, +6 halves the file. One frame is in memory at a time.
    """
    folder = Path(folder)
    phantom = Phantom(config, threads)
    poses = camera_path(phantom.colon, phantom.caster, config.motion, config.seed)
    for name in ("rgb", "depth"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    nearest_mm = np.full(len(phantom.colon.triangles), np.inf, np.float32)
    with _video(folder / "video.mp4", config, crf) as add_to_video:
        for index, frame in enumerate(phantom.film(poses)):
            _write_frame(folder, index, frame)
            add_to_video(frame.image)
            hit = frame.triangle >= 0
            np.minimum.at(nearest_mm, frame.triangle[hit], frame.depth[hit].astype(np.float32))
            if progress:
                progress(index + 1, len(poses))
    _write_trajectory(folder / "trajectory.txt", poses, config.motion.fps)
    write_ply(folder / "mesh.ply", phantom.colon.vertices, phantom.colon.triangles, nearest_mm)
    _write_records(folder, phantom)
    return folder


def _write_frame(folder: Path, index: int, frame: Frame) -> None:
    cv2.imwrite(str(folder / "rgb" / f"{index:05d}.png"), cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    stored = np.clip(np.round(frame.depth / DEPTH_UNIT_MM), 0, 65535).astype(np.uint16)
    cv2.imwrite(str(folder / "depth" / f"{index:05d}.png"), stored)


@contextmanager
def _video(path: Path, config: PhantomConfig, crf: int) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """Open an H.264 file; the value is a function that appends an RGB image (H,W,3)."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=Fraction(config.motion.fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = config.camera.width, config.camera.height, "yuv420p"
        # Same bytes each time: one thread, and no macroblock tree, whose lookahead reads uninitialised memory.
        stream.options = {"crf": str(crf), "preset": "slow", "threads": "1", "x264-params": "mbtree=0"}

        def add(image: NDArray[np.uint8]) -> None:
            planes = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420)  # swscale's rounding depends on memory alignment
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))

        yield add
        container.mux(stream.encode())


def _write_trajectory(path: Path, poses: NDArray[np.float64], fps: float) -> None:
    turns = Rotation.from_matrix(poses[:, :3, :3]).as_quat()  # x y z w
    rows = np.concatenate([np.arange(len(poses))[:, None] / fps, poses[:, :3, 3], turns], axis=1)
    np.savetxt(path, rows, fmt=["%.6f"] * 4 + ["%.9f"] * 4)


def write_ply(
    path: Path, vertices: NDArray[np.float32], triangles: NDArray[np.int32], nearest_mm: NDArray[np.float32]
) -> None:
    """Binary PLY: vertices (V,3) mm, triangles (F,3); for each face `nearest_mm` (F,), and `seen` if that is finite."""
    wide = len(vertices) > 65535  # two bytes for a corner where they suffice
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment unit mm\n"
        f"element vertex {len(vertices)}\nproperty float x\nproperty float y\nproperty float z\n"
        f"element face {len(triangles)}\nproperty list uchar {'int' if wide else 'ushort'} vertex_indices\n"
        "property uchar seen\nproperty float nearest_mm\nend_header\n"
    )
    layout = [("count", "u1"), ("corners", "<i4" if wide else "<u2", 3), ("seen", "u1"), ("nearest_mm", "<f4")]
    faces = np.empty(len(triangles), layout)
    faces["count"], faces["corners"] = 3, triangles
    faces["seen"], faces["nearest_mm"] = np.isfinite(nearest_mm), nearest_mm
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + faces.tobytes())


def _write_records(folder: Path, phantom: Phantom) -> None:
    camera = phantom.camera.to_dict() | {"fps": phantom.config.motion.fps, "depth_unit_mm": DEPTH_UNIT_MM}
    (folder / "camera.json").write_text(json.dumps(camera) + "\n")
    polyps = [asdict(polyp) for polyp in phantom.colon.polyps]
    (folder / "polyps.json").write_text(json.dumps(polyps, indent=1) + "\n")
    (folder / "config.yaml").write_text(yaml.safe_dump(phantom.config.to_dict(), sort_keys=False))
