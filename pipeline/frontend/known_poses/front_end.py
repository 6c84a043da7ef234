"""Front end `poses`: no tracking; the frames' poses are read from a file, and their features triangulated.

The world and the unit stay those of the file. Poses are tested against the pictures first (`pose_check`).
"""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.progress import Progress
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array, inverse
from haustra.core.text import counted
from haustra.core.threads import single_threaded
from pipeline.config import FrontEndSettings
from pipeline.frontend.base import FoundSubmap, FrontEndResult
from pipeline.frontend.known_poses.pose_check import FITS, ROUGHLY_FITS, check_poses
from pipeline.frontend.known_poses.posed_map import build_map
from pipeline.frontend.known_poses.stray_poses import stray_poses
from pipeline.frontend.known_poses.time_shift import first_by_pictures
from pipeline.input.frames import Frames
from pipeline.input.pose_files.pose_table import POSES_UNIT, FilmFrames, first_numbers, poses_by_frame
from pipeline.input.pose_files.registry import read_poses
from pipeline.input.sensor.usual_distances import check_view
from pipeline.mapping.feature_triangulation import choose_frames
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.mapping.submap import MIN_FRAMES, Submap
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift_cache import SiftCache
from pipeline.run_folder.workspace import Workspace

NAME = "poses"
# Share of the width that the view moves by between frames whose features are matched, at most: nothing is tracked
# between them, as it is where --fast has 0.05. Chosen on loop_b, withdrawal_b and low_texture_b of coverage_films.yaml.
MOST_MOTION = 0.025


class KnownPosesFrontEnd:
    """One submap, in the world and the unit of the poses' file."""

    closes_loops = True  # the poses are given: there is nothing to close

    def check(self, settings: FrontEndSettings) -> None:
        if settings.poses.file is None:
            raise HaustraError("the front end poses needs a file of poses: --poses FILE")
        read_poses(Path(settings.poses.file), _path(settings.poses.hand_eye))

    def run(
        self, frames: Frames, features: SiftCache, settings: FrontEndSettings, workspace: Workspace, progress: Progress
    ) -> FrontEndResult:
        table = read_poses(Path(settings.poses.file or ""), _path(settings.poses.hand_eye))
        rays, film = RayTable(frames.camera), FilmFrames.of(workspace)
        readings = {first: poses_by_frame(table, film, first) for first in first_numbers(table, film)}
        with single_threaded():
            first = first_by_pictures(readings, frames.index, rays, features)
        if len(readings) > 1:
            progress.log(f"the names of pictures in {table.path.name} count from {first}, by what the pictures show")
        by_frame = readings[first]
        index = np.array([frame for frame in frames.index.tolist() if frame in by_frame], np.int64)
        if len(index) < MIN_FRAMES:
            raise HaustraError(
                f"{table.path} has poses of {len(index)} of the {len(frames.index)} usable frames; three are needed"
            )
        index, given = _without_stray(index, by_frame, table.path, progress)
        refine = settings.poses.refine
        with single_threaded():
            fits = ROUGHLY_FITS if refine else FITS
            of_table = table.sensor_from_camera, film.spacing(table), table.written
            check = check_poses(table.path, index.tolist(), given, rays, features, fits, *of_table)
            if settings.poses.mm_per_unit is not None:
                check_view(check.depth * settings.poses.mm_per_unit, "poses", POSES_UNIT)
            progress.log(
                f"poses of {_called(table.path)}: {len(index)} of {len(frames.index)} frames; "
                f"{100 * check.inliers:.0f} % of {check.matches} matches lie on their epipolar lines"
            )
            motion = min(settings.odometry.keyframe_motion, MOST_MOTION) * frames.camera.width
            rows = choose_frames(given, check.depth, rays.focal_px, motion, least=0)
            with progress.bar("triangulation", len(rows)) as advance:
                local_map = build_map(index[rows].tolist(), given[rows], rays, features, refine, advance)
                if refine:
                    adjust_all(local_map, True, advance)
        submap = to_submap(local_map, frames.camera.params, refit=refine)
        if submap is None:
            raise HaustraError(f"the poses of {table.path} triangulate no points that {MIN_FRAMES} frames see")
        whole = _with_all_frames(submap, index, _moved(local_map, given, rows) if refine else given)
        if refine:
            whole = in_world_of(whole, given)
        return FrontEndResult({NAME: [FoundSubmap(whole)]}, {"inliers": check.inliers})


def _called(path: Path) -> str:
    """A file's name; of a folder its parent's, too, since COLMAP's models are called by numbers."""
    return "/".join(path.resolve().parts[-2:]) if path.is_dir() else path.name


def _without_stray(
    index: NDArray[np.int64], by_frame: Mapping[int, Array], path: Path, progress: Progress
) -> tuple[NDArray[np.int64], Array]:
    """Frames (N,) and their poses (N,4,4), those left out that lie far from the poses around; says so."""
    given = np.stack([by_frame[frame] for frame in index.tolist()])
    stray, away = stray_poses(given, index)
    if stray.any():
        worst = int(np.where(stray, away, 0).argmax())
        progress.log(
            f"poses of {_called(path)}: {counted(int(stray.sum()), 'frame')} left out, far from the poses before and "
            f"after: frame {index[worst]} by {away[worst]:.3g} in the poses' unit"
        )
    return index[~stray], given[~stray]


def _moved(local_map: LocalMap, given: Array, rows: NDArray[np.int64]) -> Array:
    """All poses (N,4,4) after the keyframes, at `rows`, were adjusted: frames between them follow the last one."""
    now = np.stack([inverse(keyframe.camera_from_world) for keyframe in local_map.keyframes])
    last = np.maximum(np.searchsorted(rows, np.arange(len(given)), side="right") - 1, 0)
    return np.stack([now[k] @ inverse(given[rows[k]]) @ posed for k, posed in zip(last, given, strict=True)])


def _with_all_frames(submap: Submap, index: NDArray[np.int64], given: Array) -> Submap:
    """The submap with every frame that has a pose; those between keyframes saw no point."""
    observations = submap.observations.copy()
    observations[:, 0] = np.searchsorted(index, submap.frames)[observations[:, 0]]
    world_from_camera = np.array(given, np.float64)
    world_from_camera[np.searchsorted(index, submap.frames)] = submap.world_from_camera
    return replace(submap, frames=index, world_from_camera=world_from_camera, observations=observations)


def in_world_of(submap: Submap, world_from_camera: Array) -> Submap:
    """The adjusted submap brought back to the world and the unit of the poses given (N,4,4).

    The turn is the mean one of the cameras', which a straight path tells, too; scale and shift are of their centres.
    """
    centres, given = submap.centres, world_from_camera[:, :3, 3]
    turn = Rotation.from_matrix(
        world_from_camera[:, :3, :3] @ np.swapaxes(submap.world_from_camera[:, :3, :3], 1, 2)
    ).mean()
    spread, wanted = turn.apply(centres - centres.mean(axis=0)), given - given.mean(axis=0)
    scale = float((spread * wanted).sum() / np.maximum((spread**2).sum(), 1e-300))
    shift = given.mean(axis=0) - scale * turn.apply(centres.mean(axis=0))
    moved = submap.world_from_camera.copy()
    moved[:, :3, :3] = turn.as_matrix() @ moved[:, :3, :3]
    moved[:, :3, 3] = scale * turn.apply(centres) + shift
    return replace(submap, world_from_camera=moved, points=scale * turn.apply(submap.points) + shift)


def _path(name: str | None) -> Path | None:
    return None if name is None else Path(name)
