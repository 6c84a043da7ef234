"""RGB-D folder of a phantom: video, images, depth, trajectory, mesh and the config that made them.

video.mp4       H.264, what a user would have
rgb/%05d.png    the same frames, lossless
depth/%05d.png  uint16 z-depth in units of 0.01 mm, 0 = none
trajectory.txt  TUM lines "seconds tx ty tz qx qy qz qw", world_from_camera, mm
mesh.ply        the wall at rest, mm; face properties: `seen` is 1 where any frame's pixel centre hit it, `nearest_mm`
                the smallest depth at which one did (infinite where none). Where the wall moves, vertex properties
                axis_x axis_y axis_z arc_mm say how each vertex moves (see `peristalsis`, `living_wall`)
events.json     what happened when: manoeuvres and events with frames and seconds; per frame, each contraction
wall_motion.json  with `tissue.amplitude_mm`: the state of the living wall in each frame (see `living_wall`)
camera.json  polyps.json  diverticula.json  config.yaml

Depth is that of the wall: 0 under burned-in text, outside the border mask, and where an event hides the wall.
mesh.ply is written last: a folder without it is unfinished.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
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

from haustra.core.errors import PhantomError
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.checks import check
from haustra.phantom.dataset.script import Script, write_script
from haustra.phantom.imaging.render import Frame, Phantom
from haustra.phantom.motion.living_wall import LivingWall
from haustra.phantom.motion.peristalsis import WIDTH_MM, Peristalsis

FILES = ("video.mp4", "trajectory.txt", "mesh.ply", "events.json", "camera.json", "config.yaml")
RECORDS = ("polyps.json", "diverticula.json", "wall_motion.json")
DEPTH_UNIT_MM = 0.01  # of depth images; uint16 then reaches 655 mm
Progress = Callable[[int, int], None]


def generate(
    config: PhantomConfig,
    folder: Path,
    progress: Progress | None = None,
    crf: int = 18,
    threads: int = 0,
    preset: str = "veryfast",
    recordings: Path = Path(),
) -> Path:
    """Film one phantom into `folder` (made if missing); `progress(done, total)` counts frames.

    `crf` is x264's constant rate factor: 18 looks lossless, +6 halves the file; `preset` is x264's, too. A few frames
    are in memory at a time.
    Raises PhantomError where the config cannot be built or filmed.
    """
    folder = Path(folder)
    check(config)
    phantom = Phantom(config, threads)
    script = write_script(phantom, recordings)
    folder.mkdir(parents=True, exist_ok=True)
    _write_records(folder, phantom)
    _write_trajectory(folder / "trajectory.txt", script.world_from_camera, config.motion.fps)
    _write_events(folder / "events.json", script, config.motion.fps)
    if isinstance(script.wall, LivingWall):
        (folder / "wall_motion.json").write_text(json.dumps(script.wall.record(config.motion.frames)) + "\n")
    nearest_mm = film_into(folder, phantom, script, progress, crf, preset)
    moves = config.events.peristalsis or config.tissue.amplitude_mm
    motion = script.wall.vertex_properties() if moves else {}
    write_ply(folder / "mesh.ply", phantom.colon.vertices, phantom.colon.triangles, nearest_mm, motion)
    return folder


def film_into(
    folder: Path,
    phantom: Phantom,
    script: Script,
    progress: Progress | None = None,
    crf: int = 18,
    preset: str = "veryfast",
) -> NDArray[np.float32]:
    """Write video, images and depth; returns the smallest depth (F,) mm at which each face was seen, or infinity."""
    for name in ("rgb", "depth"):
        (folder / name).mkdir(exist_ok=True)
    nearest_mm = np.full(len(phantom.colon.triangles), np.inf, np.float32)
    with _video(folder / "video.mp4", phantom.config, crf, preset) as add_to_video:
        for index, frame in enumerate(phantom.film(script.world_from_camera, script.timeline, script.wall)):
            _write_frame(folder, index, frame)
            add_to_video(frame.image)
            hit = frame.triangle >= 0
            np.minimum.at(nearest_mm, frame.triangle[hit], frame.depth[hit])
            if progress:
                progress(index + 1, len(script.world_from_camera))
    return nearest_mm


def is_finished(folder: Path, config: PhantomConfig) -> bool:
    """True if `folder` already holds exactly this phantom, and all of it."""
    return (Path(folder) / "mesh.ply").exists() and is_begun(folder, config)


def is_begun(folder: Path, config: PhantomConfig) -> bool:
    """True if what `folder` holds, whole or not, is of exactly this phantom."""
    record = Path(folder) / "config.yaml"
    if not record.exists():
        return False
    try:
        return PhantomConfig.from_dict(yaml.safe_load(record.read_text())) == config
    except (PhantomError, yaml.YAMLError, UnicodeDecodeError):
        return False


def clear(folder: Path) -> None:
    """Remove what `generate` writes, and nothing else."""
    folder = Path(folder)
    for pattern in ("rgb/[0-9]*.png", "depth/[0-9]*.png", *FILES, *RECORDS):
        for path in folder.glob(pattern):
            path.unlink()


def _write_frame(folder: Path, index: int, frame: Frame) -> None:
    """Write image and depth of one frame."""
    _write_png(folder / "rgb" / f"{index:05d}.png", cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR))
    steps = np.round(frame.depth / DEPTH_UNIT_MM)
    stored = np.where(steps <= 65535, steps, 0).astype(np.uint16)  # what is farther than 655 mm has no depth
    _write_png(folder / "depth" / f"{index:05d}.png", stored)


def _write_png(path: Path, image: NDArray[Any]) -> None:
    """Write a PNG; OSError on a full disk, which cv2.imwrite would not report."""
    path.write_bytes(cv2.imencode(".png", image)[1].tobytes())


@contextmanager
def _video(path: Path, config: PhantomConfig, crf: int, preset: str) -> Iterator[Callable[[NDArray[np.uint8]], None]]:
    """Open an H.264 file; the value is a function that appends an RGB image (H,W,3)."""
    with av.open(str(path), "w") as container:
        stream: Any = container.add_stream("libx264", rate=Fraction(config.motion.fps).limit_denominator(1001))
        stream.width, stream.height, stream.pix_fmt = config.camera.width, config.camera.height, "yuv420p"
        # Same bytes each time: one thread, and no macroblock tree, whose lookahead reads uninitialised memory.
        stream.options = {"crf": str(crf), "preset": preset, "threads": "1", "x264-params": "mbtree=0"}

        def add(image: NDArray[np.uint8]) -> None:
            planes = cv2.cvtColor(image, cv2.COLOR_RGB2YUV_I420)  # swscale's rounding depends on memory alignment
            container.mux(stream.encode(av.VideoFrame.from_ndarray(planes, format="yuv420p")))

        try:
            yield add
        finally:  # what was filmed before an interruption can be played
            container.mux(stream.encode())


def _write_trajectory(path: Path, world_from_camera: NDArray[np.float64], fps: float) -> None:
    """Write a TUM file of `world_from_camera` (N,4,4)."""
    turns = Rotation.from_matrix(world_from_camera[:, :3, :3]).as_quat()  # x y z w
    rows = np.concatenate(
        [np.arange(len(world_from_camera))[:, None] / fps, world_from_camera[:, :3, 3], turns], axis=1
    )
    np.savetxt(path, rows, fmt=["%.6f"] * 4 + ["%.9f"] * 4)


def write_ply(
    path: Path,
    vertices: NDArray[np.float32],
    triangles: NDArray[np.int32],
    nearest_mm: NDArray[np.float32],
    vertex_properties: Mapping[str, NDArray[np.float32]] | None = None,
) -> None:
    """Binary PLY: vertices (V,3) mm, triangles (F,3); for each face `nearest_mm` (F,), and `seen` if that is finite.

    `vertex_properties` are further floats (V,) by name.
    """
    more = dict(vertex_properties or {})
    wide = len(vertices) > 65535  # two bytes for a corner where they suffice
    floats = "".join(f"property float {name}\n" for name in ("x", "y", "z", *more))
    header = (
        "ply\nformat binary_little_endian 1.0\ncomment unit mm\n"
        f"element vertex {len(vertices)}\n{floats}"
        f"element face {len(triangles)}\nproperty list uchar {'int' if wide else 'ushort'} vertex_indices\n"
        "property uchar seen\nproperty float nearest_mm\nend_header\n"
    )
    layout = [("count", "u1"), ("corners", "<i4" if wide else "<u2", 3), ("seen", "u1"), ("nearest_mm", "<f4")]
    faces = np.empty(len(triangles), layout)
    faces["count"], faces["corners"] = 3, triangles
    faces["seen"], faces["nearest_mm"] = np.isfinite(nearest_mm), nearest_mm
    table = np.column_stack([vertices, *more.values()]).astype("<f4")
    partial = path.with_name(path.name + ".partial")
    partial.write_bytes(header.encode() + table.tobytes() + faces.tobytes())
    os.replace(partial, path)  # a full disk must not leave half a mesh, which is the sign of a whole film


def _write_records(folder: Path, phantom: Phantom) -> None:
    """Lens, lesions, and the config with its seed."""
    camera = phantom.camera.to_dict() | {"fps": phantom.config.motion.fps, "depth_unit_mm": DEPTH_UNIT_MM}
    (folder / "camera.json").write_text(json.dumps(camera) + "\n")
    for name in ("polyps", "diverticula"):
        lesions = [asdict(lesion) for lesion in getattr(phantom.colon, name)]
        (folder / f"{name}.json").write_text(json.dumps(lesions, indent=1) + "\n")
    (folder / "config.yaml").write_text(yaml.safe_dump(phantom.config.to_dict(), sort_keys=False))


def _write_events(path: Path, script: Script, fps: float) -> None:
    """{"slots": [{kind, first_frame, last_frame, first_s, last_s}], "contractions": [{frame, centre_mm, ...}]}."""
    slots = [
        {
            "kind": slot.kind,
            "first_frame": slot.first,
            "last_frame": slot.last,
            "first_s": round(slot.first / fps, 6),
            "last_s": round(slot.last / fps, 6),
        }
        for slot in script.timeline
    ]
    waves = script.wall.waves if isinstance(script.wall, Peristalsis) else {}
    contractions = [asdict(wave) | {"width_mm": WIDTH_MM} for wave in waves.values()]
    path.write_text(json.dumps({"slots": slots, "contractions": contractions}, indent=1) + "\n")
