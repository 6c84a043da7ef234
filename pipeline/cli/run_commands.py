"""The commands that make runs and show them: `reconstruct`, `haustra batch` and `haustra view`."""

import os
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from haustra.core.errors import HaustraError
from haustra.core.text import counted
from pipeline.cli.given_paths import must_be_named_or_exist, must_exist, must_match

if TYPE_CHECKING:
    from pipeline.config import Config


def print_version(wanted: bool) -> None:
    """The installed version on standard output, and no more."""
    if wanted:
        print(metadata.version("haustra"))
        raise typer.Exit


Camera = Annotated[str | None, typer.Option(help="auto, a preset's name, or a calibration file")]
FrontEnd = Annotated[str | None, typer.Option(help="auto: odometry, and sfm if that is doubtful; or one by name")]
Model = Annotated[str | None, typer.Option(help="completion model: mscsa, or a weight file")]
LumenMm = Annotated[float | None, typer.Option(help="median lumen diameter in mm; sets the scale")]
Start = Annotated[float | None, typer.Option(min=0, help="s; leave out what comes before")]
End = Annotated[float | None, typer.Option(min=0, help="s; leave out what comes after")]
Stride = Annotated[int | None, typer.Option(min=1, help="use every n-th frame")]
ConfigFile = Annotated[Path | None, typer.Option(help="YAML file of settings; options given beside it win")]
Fast = Annotated[bool, typer.Option("--fast", help="fewer keyframes: about a quarter less time, less detail")]
Seed = Annotated[int | None, typer.Option(help="of every random step")]
Device = Annotated[str | None, typer.Option(help="auto, cpu or cuda")]
Version = Annotated[
    bool, typer.Option("--version", callback=print_version, is_eager=True, help="print the version and exit")
]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")]


def reconstruct(
    source: Annotated[Path | None, typer.Argument(help="video file, image folder or RGB-D folder")] = None,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="run folder; NAME_run in the current folder if not given")
    ] = None,
    demo: Annotated[bool, typer.Option("--demo", help="reconstruct the embedded clip and print its error")] = False,
    camera: Camera = None,
    front_end: FrontEnd = None,
    model: Model = None,
    lumen_mm: LumenMm = None,
    scale: Annotated[str | None, typer.Option(help="scale file: mm_per_unit, or frame_a, frame_b, distance_mm")] = None,
    poses: Annotated[
        str | None, typer.Option(help="camera poses: TUM, KITTI, tracker CSV, COLMAP model folder or transforms.json")
    ] = None,
    poses_mm: Annotated[float | None, typer.Option(help="mm per unit of the poses: 1, or 1000 of metres")] = None,
    hand_eye: Annotated[str | None, typer.Option(help="file of sensor_from_camera, for a tracker's CSV")] = None,
    refine_poses: Annotated[
        bool, typer.Option("--refine-poses", help="adjust the given poses to the pictures")
    ] = False,
    stereo: Annotated[str | None, typer.Option(help="calibration of a stereo endoscope: OpenCV YAML, or INI")] = None,
    stereo_layout: Annotated[str | None, typer.Option(help="side-by-side, over-under or interlaced")] = None,
    stereo_right: Annotated[str | None, typer.Option(help="film of the right eye, if it has its own")] = None,
    depth: Annotated[
        str | None, typer.Option(help="sensor: metric depth beside the pictures; none: leave it out")
    ] = None,
    depth_folder: Annotated[str | None, typer.Option(help="folder of the sensor's 16-bit depth images")] = None,
    depth_unit_mm: Annotated[float | None, typer.Option(help="mm of a step of the depth images")] = None,
    start: Start = None,
    end: End = None,
    stride: Stride = None,
    config: ConfigFile = None,
    fast: Fast = False,
    chunks: Annotated[int | None, typer.Option(min=1, help="track the video in so many parts at once")] = None,
    ray: Annotated[
        str | None, typer.Option(help="Ray cluster that tracks the chunks, or local; needs the extra: cluster")
    ] = None,
    seed: Seed = None,
    device: Device = None,
    rerun: Annotated[
        bool, typer.Option("--rerun", help="also write run.rrd, for Rerun; needs the extra: rerun")
    ] = False,
    profile: Annotated[bool, typer.Option("--profile", help="time and memory of each stage, in metrics.json")] = False,
    resume: Annotated[bool, typer.Option("--resume", help="go on after a stop, or with another scale")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace the run in the output folder")] = False,
    quiet: Quiet = False,
    version: Version = False,
) -> None:
    """Video in, coloured colon mesh, camera path, dense depth and report out."""
    if (source is None) == (not demo):
        raise HaustraError("give one video or folder, or --demo")
    must_exist(source, scale, poses, hand_eye, stereo, stereo_right, depth_folder, config)
    must_be_named_or_exist("--camera", camera)
    must_be_named_or_exist("--model", model)
    from haustra.core.progress import SilentProgress, TerminalProgress
    from pipeline.config import load_config
    from pipeline.given_settings import TWO_LAYOUTS, WITHOUT_STEREO
    from pipeline.run_folder.malloc import return_freed_memory
    from pipeline.run_folder.workspace import Workspace

    return_freed_memory()  # each stage asks for arrays of other sizes; while a network works, it is kept
    if rerun:
        from pipeline.report.rerun_export import check_rerun, export_rerun

        check_rerun()  # before the work, not after it
    settings = load_config(
        config,
        camera=camera,
        front_end=front_end,
        model=model,
        lumen_mm=lumen_mm,
        scale_file=scale,
        frames={"start_s": start, "end_s": end, "stride": stride},
        odometry=paced(fast) | {"chunks": chunks, "ray": ray},
        poses={"file": poses, "mm_per_unit": poses_mm, "hand_eye": hand_eye, "refine": refine_poses or None},
        stereo={"calibration": stereo, "layout": stereo_layout, "right": stereo_right},
        sensor={"depth": depth, "folder": depth_folder, "unit_mm": depth_unit_mm},
        seed=seed,
        device=device,
    )
    if stereo_layout is not None and settings.stereo.calibration is None:  # the default, too, which the settings take
        raise HaustraError(WITHOUT_STEREO)
    if stereo_layout is not None and settings.stereo.right is not None:
        raise HaustraError(TWO_LAYOUTS)
    again: dict[str, Any] = {"resume": resume, "overwrite": overwrite, "profile": profile}
    again["progress"] = SilentProgress() if quiet else TerminalProgress()
    if demo:
        from pipeline.demo import run_demo

        output = output or Path("demo_run")
        print(run_demo(output, settings, **again))
    else:
        assert source is not None
        from pipeline.input.video import Source

        Source(source)  # what is no video is answered before the heavy packages are loaded
        from pipeline.run import reconstruct as run

        named = source.resolve()  # a dot in a folder's name begins no suffix
        output = output or Path(f"{named.name if named.is_dir() else named.stem}_run")
        run(source, output, settings, **again)
    if rerun:
        recording = export_rerun(output, Workspace(output).recording)
        if not quiet:
            print(recording)


def view(
    run: Annotated[Path, typer.Argument(help="run folder, or a folder of runs")],
    port: Annotated[int, typer.Option(min=0, help="0: a free one")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open it")] = True,
) -> None:
    """Show a run's report in the browser, or the runs of a folder: a list, a player, two beside each other."""
    must_exist(run)

    def say(sentence: str) -> None:
        print(sentence, flush=True)

    if (run / "run.yaml").is_file():
        from pipeline.report.server import view as serve

        serve(run, port, browser, say)
    else:
        from pipeline.report.viewer.view_folder import view_folder

        view_folder(run, port, browser, say)


def batch(
    videos: Annotated[list[Path], typer.Argument(help="video files, image folders or RGB-D folders")],
    output: Annotated[Path, typer.Option("--output", "-o", help="folder for all run folders")],
    jobs: Annotated[int | None, typer.Option(min=1, help="videos at a time; half the CPUs if not given")] = None,
    ray: Annotated[
        str | None, typer.Option(help="address of a Ray cluster, or local; needs the extra: cluster")
    ] = None,
    camera: Camera = None,
    front_end: FrontEnd = None,
    model: Model = None,
    lumen_mm: LumenMm = None,
    start: Start = None,
    end: End = None,
    stride: Stride = None,
    config: ConfigFile = None,
    fast: Fast = False,
    seed: Seed = None,
    device: Device = None,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="replace runs of another video or with other settings; keep the rest")
    ] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but the table")] = False,
) -> None:
    """Reconstruct many videos; one that fails never stops the rest, and the same command goes on where it stopped."""
    must_exist(config)
    must_match(*videos)
    must_be_named_or_exist("--camera", camera)
    from haustra.core.progress import SilentProgress, TerminalProgress
    from pipeline.cli.batch import process_pool, resume_hint, run_batch
    from pipeline.cli.batch_ray import ray_pool
    from pipeline.cli.batch_table import print_table
    from pipeline.config import load_config

    given: dict[str, Any] = {"camera": camera, "front_end": front_end, "model": model, "lumen_mm": lumen_mm}
    given |= {"seed": seed, "device": device}
    frames = {"start_s": start, "end_s": end, "stride": stride}
    given |= files_in_full(load_config(config, frames=frames, odometry=paced(fast), **given))
    settings = load_config(config, frames=frames, odometry=paced(fast), **given)
    given |= {"start": start, "end": end, "stride": stride}
    arguments = options_of(given | {"config": None if config is None else str(config.resolve())}) + fast * ["--fast"]
    workers = jobs or max(1, (os.cpu_count() or 2) // 2)
    pool = process_pool(workers) if ray is None else ray_pool(ray, workers)
    try:
        progress = SilentProgress() if quiet else TerminalProgress()
        outcomes = run_batch(videos, output, arguments, settings, pool, progress, overwrite)
    except KeyboardInterrupt:
        print(f"what was finished is in {output / 'batch.csv'}")
        raise
    print_table(outcomes)
    failed = sum(outcome.status == "failed" for outcome in outcomes)
    if failed:
        of = f"{failed} of {counted(len(outcomes), 'video')} failed"
        raise HaustraError(f"{of}; {resume_hint(videos, output, settings, failed)}")


def paced(fast: bool) -> dict[str, Any]:
    """Odometry's settings of `--fast`."""
    from pipeline.config import FAST_KEYFRAME_MOTION

    return {"keyframe_motion": FAST_KEYFRAME_MOTION if fast else None}


def files_in_full(settings: "Config") -> dict[str, str]:
    """The settings that are files, by their full paths: a task may run in another folder or on another machine."""
    from completion.weights.shipped_weights import SHIPPED_WEIGHTS
    from pipeline.input.camera_presets import PRESETS

    names = {"auto", *PRESETS, *SHIPPED_WEIGHTS}
    chosen = {"camera": settings.camera, "model": settings.model, "scale_file": settings.scale_file}
    return {
        name: str(Path(value).resolve())
        for name, value in chosen.items()
        if value is not None and value not in names and Path(value).is_file()
    }


def options_of(given: dict[str, Any]) -> list[str]:
    """The words of `reconstruct`'s command line."""
    options = {"scale_file": "--scale"}
    return [
        word
        for name, value in given.items()
        if value is not None
        for word in (options.get(name, "--" + name.replace("_", "-")), str(value))
    ]
