"""The process that makes depth and surface of keyframes as they settle: complete, compare, fuse, extract."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from haustra.core.threads import processors
from pipeline.config import Config, ConsistencySettings, FusionSettings
from pipeline.depth.completion_stage import MIN_POINTS, inside_of
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.input.frames import write_image, write_png
from pipeline.live.live_tracking import SettledKeyframe
from pipeline.live.surface_part import KeyframeFate, SurfacePart, part_of
from pipeline.live.warm_up import SIDE, small_camera, small_keyframes
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.depth_filter import admitted_confidence
from reconstruction.fusion.depth_consistency import DepthView, agreement
from reconstruction.fusion.tsdf import SurfaceFusion, TsdfSettings, choose_voxel_size
from reconstruction.mesh.decimation import decimated

if TYPE_CHECKING:
    from completion.inference.completer import DepthCompleter

# Voxels of the live surface over those of a run: half the detail is an eighth of the work, and what the page can draw.
COARSER = 2.0
LIVE_TRUNCATION_VOXELS = 6.0  # of these; a greater length than a run's, as these poses are not adjusted yet
PART_KEYFRAMES = 60  # after which a part of the surface is closed: extraction must not grow with the film
CLOSED_FACES = 8_000  # of a part that does not grow any more
COMPARED_WITH = 2  # keyframes before, whose depth may contradict


@dataclass(frozen=True)
class LiveSetup:
    """What a process needs to begin with. folder: where keyframes are kept, for the review."""

    config: Config
    folder: Path


@dataclass(frozen=True)
class LiveCamera:
    """The first job: camera and content (H,W) of the working frames, which the first frames of the source tell."""

    camera: Camera
    content: NDArray[np.uint8]


@dataclass(frozen=True)
class DenseResult:
    """What became of a keyframe. depth_png: (H,W) depth as a picture for the page, empty where it had too few
    points. fate: "unsure" there too. parts: those that changed; the last one grows. came: as the keyframe has it."""

    frame: int
    map_number: int
    came: float
    depth_png: bytes
    fate: KeyframeFate
    parts: tuple[SurfacePart, ...]


class DenseWork:
    """The growing surface of one camera."""

    def __init__(
        self,
        seen: LiveCamera,
        folder: Path,
        fusion: FusionSettings,
        consistency: ConsistencySettings,
        completer: DepthCompleter,
    ) -> None:
        self.settings, self.consistency, self.completer = fusion, consistency, completer
        self.rectifier = make_rectifier(seen.camera)
        self.content = self.rectifier.mask(seen.content)
        self._inside = inside_of(self.content)
        workspace = Workspace(folder)
        self._images, self._store = workspace, DiskKeyframes(workspace)
        for folder in (workspace.images, workspace.masks, workspace.depth, workspace.confidence):
            folder.mkdir(parents=True, exist_ok=True)
        self._views: deque[DepthView] = deque(maxlen=COMPARED_WITH)
        self._fusion: SurfaceFusion | None = None
        self._map_number, self._part, self._version, self._keyframes = -1, -1, 0, 0
        self._frames = (0, 0)

    def __call__(self, keyframe: SettledKeyframe) -> DenseResult:
        parts: list[SurfacePart] = []
        if keyframe.map_number != self._map_number:
            parts += self._closed_part()
            self._map_number = keyframe.map_number
            self._views.clear()
        shown = b""
        fate: KeyframeFate = "unsure"
        completed = self._completed(keyframe)
        if completed is not None:
            rgb, depth, confidence = completed
            self._keep(keyframe, depth, confidence)
            shown = painted_png(depth)
            fate, changed = self._fused(keyframe, rgb, depth, confidence)
            parts += changed
        return DenseResult(keyframe.frame, keyframe.map_number, keyframe.came, shown, fate, tuple(parts))

    def _completed(
        self, keyframe: SettledKeyframe
    ) -> tuple[NDArray[np.uint8], NDArray[np.float32], NDArray[np.float32]] | None:
        sparse = SparseDepthMaker(keyframe.around, self.rectifier.camera).sparse_depth(keyframe.row)
        if len(sparse.depth) < MIN_POINTS:
            return None
        rgb = self.rectifier.image(keyframe.rgb)
        depth, confidence = self.completer(rgb, *sparse.maps(*self.content.shape))
        nothing = np.float32(0)
        return rgb, np.where(self._inside, depth, nothing), np.where(self._inside, confidence, nothing)

    def _keep(self, keyframe: SettledKeyframe, depth: NDArray[np.float32], confidence: NDArray[np.float32]) -> None:
        """On disk, for the review, which needs old keyframes too."""
        write_image(self._images.image_path(keyframe.frame), keyframe.rgb)
        write_png(self._images.mask_path(keyframe.frame), keyframe.mask)
        self._store.write_depth(keyframe.frame, depth, confidence)

    def _fused(
        self,
        keyframe: SettledKeyframe,
        rgb: NDArray[np.uint8],
        depth: NDArray[np.float32],
        confidence: NDArray[np.float32],
    ) -> tuple[KeyframeFate, list[SurfacePart]]:
        """Fuse what is sure enough and the keyframes before it do not contradict; the parts that changed."""
        parts = self._closed_part() if self._keyframes >= PART_KEYFRAMES else []
        world_from_camera, matrix = keyframe.around.world_from_camera[keyframe.row], self.rectifier.camera.matrix
        sure = np.where(confidence < self.settings.min_confidence, np.float32(0), depth)
        view = DepthView(sure, matrix, world_from_camera)
        votes = agreement(view, list(self._views), self.consistency.tolerance)
        self._views.append(view)
        if not sure.any():
            return "unsure", parts
        voxel = self._voxel_of_a_run(sure)
        limits = self.settings.min_confidence, self.settings.max_error_voxels * voxel
        admitted = admitted_confidence(confidence, depth, votes, *limits)
        if admitted is None:
            return "contradicted", parts
        if self._fusion is None:
            self._fusion = SurfaceFusion(TsdfSettings(COARSER * voxel, LIVE_TRUNCATION_VOXELS))
            self._part, self._version, self._keyframes = self._part + 1, 0, 0
            self._frames = (keyframe.frame, keyframe.frame)
        self._fusion.integrate(rgb, depth, admitted, matrix, world_from_camera)
        self._keyframes, self._frames = self._keyframes + 1, (self._frames[0], keyframe.frame)
        return "fused", parts + self._current_part()

    def _voxel_of_a_run(self, depth: NDArray[np.float32]) -> float:
        """Size of the voxels that a run would have, by the depth of the part's first keyframe."""
        if self._fusion is not None:
            return self._fusion.settings.voxel_size / COARSER
        return self.settings.voxel_size or choose_voxel_size([depth], self.rectifier.camera.matrix)

    def _current_part(self, faces: int | None = None) -> list[SurfacePart]:
        assert self._fusion is not None
        mesh = self._fusion.extract()
        if len(mesh.faces) == 0:
            return []
        self._version += 1
        mesh = mesh if faces is None else decimated(mesh, faces)
        voxel = self._fusion.settings.voxel_size
        return [part_of(mesh, self._part, self._version, self._map_number, self._frames, voxel)]

    def _closed_part(self) -> list[SurfacePart]:
        """The part that grew until now, with as many faces as it will keep."""
        if self._fusion is None:
            return []
        closed = self._current_part(CLOSED_FACES)
        self._fusion, self._keyframes = None, 0
        return closed


class DenseWorker:
    """What the process calls with each job: the camera once, then keyframes."""

    def __init__(self, setup: LiveSetup) -> None:
        import torch

        from pipeline.depth.preparation import load_completer

        threads = max(1, processors() - 1)  # one is the tracker's
        torch.set_num_threads(threads)
        cv2.setNumThreads(threads)
        config = setup.config
        self._setup = setup
        self._completer = load_completer(config.model, config.device, config.depth.iterations)
        self._work: DenseWork | None = None
        self._warm_up()

    def __call__(self, job: LiveCamera | SettledKeyframe) -> DenseResult | None:
        if isinstance(job, LiveCamera):
            self._work = self._new_work(job, self._setup.folder)
            return None
        assert self._work is not None
        return self._work(job)

    def _warm_up(self) -> None:
        with TemporaryDirectory() as folder:
            work = self._new_work(LiveCamera(small_camera(), np.full((SIDE, SIDE), 255, np.uint8)), Path(folder))
            for keyframe in small_keyframes():
                work(keyframe)

    def _new_work(self, camera: LiveCamera, folder: Path) -> DenseWork:
        config = self._setup.config
        return DenseWork(camera, folder, config.fusion, config.consistency, self._completer)


def painted_png(depth: NDArray[np.float32]) -> bytes:
    """Depth (H,W), 0 = none, in colours that the colour-blind tell apart: near yellow, far blue; black where none."""
    known = depth > 0
    if not known.any():
        return b""
    low, high = np.percentile(depth[known], [1, 99])
    share = np.clip((high - depth) / max(high - low, 1e-9), 0, 1)
    shown = cv2.applyColorMap(np.rint(255 * share).astype(np.uint8), cv2.COLORMAP_CIVIDIS)
    shown[~known] = 0
    return bytes(cv2.imencode(".png", shown, [cv2.IMWRITE_PNG_COMPRESSION, 1])[1].tobytes())
