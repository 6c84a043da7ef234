"""The whole journey: an endoscope's video to a surface, one line a stage."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from pathlib import Path

from completion.weights.shipped_weights import SHIPPED_WEIGHTS, check_whole, resolve_weights, validate_weights
from haustra.core.errors import HaustraError
from haustra.core.progress import Progress, SaidOnce, SilentProgress
from pipeline.config import Config
from pipeline.depth.completion_stage import STAGE as DEPTH_STAGE
from pipeline.depth.completion_stage import complete_depth
from pipeline.depth.multiview_stage import refine_depth
from pipeline.depth.preparation import Preparation
from pipeline.depth.sensor.sensor_scale import check_frames
from pipeline.finished_run import Run
from pipeline.frontend.lens_guess import guess_lens
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.points_stage import find_points
from pipeline.frontend.registry import check_front_end
from pipeline.frontend.structure_stage import solve_structure
from pipeline.input.calibration import check_choice
from pipeline.input.frames import guessed_by, read_frames
from pipeline.input.pose_files.registry import lens_beside
from pipeline.input.sensor.sensor_depth import check_sensor, open_sensor
from pipeline.input.stereo.stereo_source import open_source
from pipeline.input.video import Source
from pipeline.loop_closing.close_loops import close_loops_stage
from pipeline.report.page.pictures import draw_pictures
from pipeline.report.report import add_profile, write_geometry, write_report
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.resuming import resume_workspace
from pipeline.run_folder.stage_clock import StageClock
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.coverage_stage import coverage_stage
from pipeline.surface.fusion_stage import SurfaceSettings, forget_lost_surfaces, fuse_depth
from pipeline.surface.given_scales import given_scales
from pipeline.surface.lamp_file import read_lamp
from pipeline.surface.scale import ScaleSource, check_scale_file, check_scale_frames
from pipeline.surface.wall_motion import wall_motion_stage


def reconstruct(
    source: Path | str,
    output: Path | str,
    config: Config | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
    profile: bool = False,
) -> Run:
    """Reconstruct a video, image folder or RGB-D folder into the run folder `output`.

    Finished stages stay on disk whatever happens, and `resume` goes on from them; but a run that was to replace another
    one by `overwrite` and is refused before it has a camera path goes, and that one comes back. profile: write the time
    and memory of each stage into `metrics.json`, and say them. Raises `HaustraError` (one sentence) for input that
    cannot be reconstructed, and for a config that is no `Config`.
    """
    if not isinstance(config, Config | None):
        raise HaustraError(f"config must be a haustra.Config, such as Config(seed=1), not a {type(config).__name__}")
    if "" in (source, output):
        raise HaustraError("a path is empty: give the film and the run folder; the current folder is written as a dot")
    config, progress = _with_lens_of_poses(config or Config()), SaidOnce(progress or SilentProgress())
    video, scale = open_source(Path(source), config.stereo), ScaleSource(config.lumen_mm, _path(config.scale_file))
    _check(config, video, scale)
    lamp = None if config.lamp_file is None else read_lamp(config.lamp_file)
    timed = StageClock()
    preparation = Preparation(config.model, config.device, config.depth.iterations)
    # The lock: nobody else works in the run folder meanwhile.
    with preparation, _workspace(video, Path(output), config, resume, overwrite) as workspace:
        if resume:
            forget_lost_surfaces(workspace)
        if workspace.made_anew:
            progress.log(f"the surface and what follows it are made anew: {workspace.made_anew}")
        preparation.begin(with_network=not workspace.is_done(DEPTH_STAGE))
        frames = timed("frames", read_frames)(video, config.camera, config.frames, workspace, progress)
        check_frames(open_sensor(workspace, frames.camera.width), frames.index)
        check_scale_frames(scale.file, frames.index)
        settings = config.front_end_settings
        if guessed_by(workspace) is not None:
            frames = timed("lens", guess_lens)(frames, settings, workspace, progress)
        with frame_features(workspace) as features:  # forgotten before depth is completed
            solve = timed("structure", solve_structure)
            submaps = solve(frames, features, config.front_end, settings, workspace, progress)
            retriangulated = timed("points", find_points)(
                frames, features, submaps, settings.odometry.keyframe_motion, workspace, progress
            )
        complete, refine = timed("depth", complete_depth), timed("depth from several views", refine_depth)
        close = timed("loop closing", close_loops_stage)
        completed = complete(frames, retriangulated, preparation.completer, config.depth, workspace, progress)
        if not config.depth.multiview:
            preparation.forget()  # no network refines depth
        completed = refine(frames, completed, preparation.completer, config.depth, workspace, progress)
        preparation.forget()
        completed = close(frames, completed, config.loop_closing, config.seed, workspace, progress)
        timed("motion", wall_motion_stage)(frames, completed, submaps, workspace, progress)
        del submaps, retriangulated  # of a long film hundreds of megabytes
        scale = replace(scale, given=given_scales(config.poses, frames, completed, workspace))
        surface = SurfaceSettings(config.fusion, config.consistency, scale, config.seed, lamp)
        surfaces = timed("surface", fuse_depth)(completed, surface, workspace, progress)
        with ThreadPoolExecutor(2, "report") as threads:  # while the coverage is measured
            pictures = threads.submit(draw_pictures, frames, completed, surfaces)
            files = threads.submit(write_geometry, frames, completed, surfaces, workspace, progress)
            coverage = timed("coverage", coverage_stage)(frames, completed, surfaces, workspace)
            timed("files", files.result)()
            done = timed.to_list() if profile else None
            timed("report", write_report)(frames, completed, surfaces, coverage, workspace, pictures.result, done)
        if profile:
            add_profile(workspace, timed.to_list(), progress)
        run = Run(workspace)
        progress.log(str(run))
        return run


def _with_lens_of_poses(config: Config) -> Config:
    """A COLMAP model and transforms.json have the lens beside the poses; it is taken where no other is named."""
    if config.poses.file is None or config.camera != "auto":
        return config
    beside = lens_beside(Path(config.poses.file))
    return config if beside is None else config.model_copy(update={"camera": str(beside)})


def _check(config: Config, video: Source, scale: ScaleSource) -> None:
    """Refuse what cannot work before any work is done."""
    check_front_end(config.front_end, config.front_end_settings)
    check_choice(config.camera, video.path)
    if note := check_sensor(video.path, config.sensor, video.announced):
        video.notes.append(note)
    if config.model in SHIPPED_WEIGHTS:
        check_whole(resolve_weights(config.model))  # without torch, which is loaded in the background
    if config.model not in SHIPPED_WEIGHTS or config.depth.iterations is not None:
        validate_weights(config.model, config.depth.iterations)
    if config.device == "cuda":
        from completion.inference.completer import choose_device

        choose_device(config.device)
    if scale.file is not None:
        check_scale_file(scale.file)


def _workspace(video: Source, output: Path, config: Config, resume: bool, overwrite: bool) -> Workspace:
    if resume:
        return resume_workspace(output, video.path, config)
    return create_workspace(output, video.path, config, overwrite)


def _path(name: str | None) -> Path | None:
    return None if name is None else Path(name)
