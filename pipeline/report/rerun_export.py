"""A run as a Rerun recording: path, mesh, and each keyframe's image, depth and confidence seen through its pinhole.

Needs the extra `[rerun]`.
"""

import hashlib
import importlib.util
from pathlib import Path
from typing import Any

import numpy as np

from haustra.core.errors import HaustraError
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.finished_run import open_run
from pipeline.input.frames import Frames
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.fusion_stage import Surface

TIMELINE = "video"
JPEG_QUALITY = 85


NO_SDK = "a Rerun recording needs its SDK: pip install 'haustra[rerun]'"


def check_rerun() -> None:
    """One sentence on how to get the SDK where it is missing; loads nothing."""
    if importlib.util.find_spec("rerun") is None:
        raise HaustraError(NO_SDK)


def import_rerun() -> Any:
    """The `rerun` module, or one sentence on how to get it."""
    try:
        import rerun
    except ImportError as error:
        raise HaustraError(NO_SDK) from error
    return rerun


def export_rerun(run: Path, target: Path) -> Path:
    """Write a finished run as `target` (.rrd), in output units, in the axes of each submap's mesh."""
    rerun = import_rerun()
    finished = open_run(run)
    recording = rerun.RecordingStream("haustra", recording_id=recording_id(finished.workspace))
    recording.save(str(target))
    for number, (completed, surface) in enumerate(zip(finished.completed_submaps, finished.surfaces, strict=True)):
        # Submaps that could not be joined share no frame: each has a root of its own.
        _log_submap(rerun, recording, f"submap_{number}", finished.frames, completed, surface)
    recording.flush()
    recording.disconnect()
    return target


def recording_id(workspace: Workspace) -> str:
    """The same for each export of a run, and another for every other run: Rerun shows recordings of one id as one."""
    source = workspace.record["source"]
    identity = "\n".join((str(workspace.root.resolve()), str(source["path"]), source["sha256"]["source"]))
    return hashlib.sha256(identity.encode()).hexdigest()[:32]


def _log_submap(
    rerun: Any, recording: Any, root: str, frames: Frames, completed: CompletedSubmap, surface: Surface
) -> None:
    submap, mesh = completed.submap.scaled(surface.scale.factor), surface.mesh
    recording.log(root, rerun.ViewCoordinates.RDF, static=True)  # x right, y down, z forward: the first camera's
    if len(mesh.faces):
        recording.log(
            f"{root}/mesh",
            rerun.Mesh3D(
                vertex_positions=mesh.vertices.astype(np.float32),
                triangle_indices=mesh.faces.astype(np.uint32),
                vertex_normals=mesh.normals.astype(np.float32),
                vertex_colors=mesh.colours,
            ),
            static=True,
        )
    recording.log(f"{root}/path", rerun.LineStrips3D([submap.centres.astype(np.float32)]), static=True)
    camera = f"{root}/camera"
    pinhole = rerun.Pinhole(
        image_from_camera=completed.camera.matrix,
        resolution=[completed.camera.width, completed.camera.height],
        camera_xyz=rerun.ViewCoordinates.RDF,
    )
    recording.log(camera, pinhole, static=True)
    keyframes = set(completed.rows.tolist())
    for row, index in enumerate(submap.frames.tolist()):
        recording.set_time(TIMELINE, duration=frames.seconds_of(index))
        recording.set_time("frame", sequence=index)
        world_from_camera = submap.world_from_camera[row]
        recording.log(camera, rerun.Transform3D(translation=world_from_camera[:3, 3], mat3x3=world_from_camera[:3, :3]))
        if row in keyframes:
            _log_keyframe(rerun, recording, camera, completed, row, surface.scale.factor)


def _log_keyframe(rerun: Any, recording: Any, camera: str, completed: CompletedSubmap, row: int, factor: float) -> None:
    keyframe = completed.keyframe(row)
    recording.log(f"{camera}/image", rerun.Image(keyframe.rgb).compress(jpeg_quality=JPEG_QUALITY))
    recording.log(f"{camera}/depth", rerun.DepthImage(keyframe.depth * np.float32(factor), meter=1.0))
    confidence = np.round(255 * keyframe.confidence).astype(np.uint8)
    recording.log(f"{camera}/confidence", rerun.Image(confidence, color_model="L").compress(jpeg_quality=JPEG_QUALITY))
