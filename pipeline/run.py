"""The whole journey: an endoscope's video to a surface, one line a stage."""

from pathlib import Path

from completion.inference.completer import choose_device
from completion.weights.shipped_weights import validate_weights
from haustra.core.progress import Progress, SilentProgress
from pipeline.config import Config
from pipeline.depth.completion_stage import complete_depth
from pipeline.finished_run import Run
from pipeline.frontend.select import solve_structure
from pipeline.input.calibration import check_choice
from pipeline.input.frames import read_frames
from pipeline.input.video import Source
from pipeline.loop_closing.close_loops import refine_poses
from pipeline.report.report import write_report
from pipeline.run_folder.workspace import create_workspace, resume_workspace
from pipeline.surface.coverage_stage import judge_coverage
from pipeline.surface.fusion_stage import fuse_depth
from pipeline.surface.scale import check_scale_file


def reconstruct(
    source: Path | str,
    output: Path | str,
    config: Config | None = None,
    *,
    resume: bool = False,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> Run:
    """Reconstruct a video, image folder or RGB-D folder into the run folder `output`.

    Finished stages stay on disk whatever happens, and `resume` goes on from them. Raises `HaustraError` (one
    sentence) for input that cannot be reconstructed.
    """
    config, progress = config or Config(), progress or SilentProgress()
    video = Source(Path(source))
    check_choice(config.camera, video.path)
    validate_weights(config.model, config.depth.iterations)
    choose_device(config.device)  # refused now, not after the film has been tracked
    if config.scale_file is not None:
        check_scale_file(Path(config.scale_file))
    if resume:
        workspace = resume_workspace(Path(output), video.path, config)
    else:
        workspace = create_workspace(Path(output), video.path, config, overwrite)
    with workspace:  # nobody else works in the folder meanwhile
        frames = read_frames(video, config, workspace, progress)
        submaps = solve_structure(frames, config, workspace, progress)  # poses and sparse points
        dense = complete_depth(frames, submaps, config, workspace, progress)  # sparse depth, completed
        dense = refine_poses(frames, dense, config, workspace, progress)  # places seen twice close the path
        surfaces = fuse_depth(dense, config, workspace, progress)
        coverage = judge_coverage(frames, dense, surfaces, workspace)  # what was not seen
        write_report(frames, dense, surfaces, coverage, workspace, progress)
        run = Run(workspace)
        progress.say(str(run))
        return run
