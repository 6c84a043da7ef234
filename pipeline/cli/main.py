"""The commands `reconstruct` and `haustra`. Heavy packages are imported inside each command, so `--help` is instant."""

import errno
import gc
import logging
import os
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Any

import typer
from typer.core import TyperArgument, TyperCommand

from haustra.core.errors import HaustraError
from pipeline.cli import given_paths
from pipeline.cli import run_commands as cli_runs
from pipeline.cli.climb import climb
from pipeline.cli.doctor import doctor
from pipeline.cli.live import live
from pipeline.cli.shadowing import refuse_shadowed_names
from pipeline.run_folder.malloc import keep_freed_memory

OF_FILE_SYSTEM = ("ENOSPC", "EACCES", "EROFS", "EDQUOT", "EFBIG", "ENOENT", "ENOTDIR", "EISDIR", "ENAMETOOLONG")
FILE_SYSTEM_SAYS_NO: tuple[int, ...] = tuple(getattr(errno, name) for name in OF_FILE_SYSTEM)
INTERRUPTED = 130  # the shell's code for Ctrl-C
KEPT = "what was finished is kept: the same command goes on (reconstruct, live: with --resume if the run was begun)"
# Help is plain text: rich's boxes take as long to load as all else.
PLAIN: dict[str, Any] = {"rich_markup_mode": None, "context_settings": {"max_content_width": 120}}

app = typer.Typer(no_args_is_help=True, add_completion=False, **PLAIN)


@app.callback()
def of_all_commands(version: cli_runs.Version = False) -> None:
    """Dense colon reconstruction from endoscope video, on a CPU."""


for command in (cli_runs.reconstruct, live, cli_runs.view, cli_runs.batch, doctor, climb):
    app.command()(command)


class ExportCommand(TyperCommand):
    """Its help lists the formats of the tables, which are loaded for that alone."""

    def format_help(self, ctx: Any, formatter: Any) -> None:
        from pipeline.report.exporters import described_formats

        for parameter in self.params:
            if isinstance(parameter, TyperArgument) and parameter.name == "target":
                folders = "with --nerfstudio, --colmap, --slicer or --climb a folder"
                parameter.help = f"file to write: {described_formats()}; {folders}"
        super().format_help(ctx, formatter)


@app.command(cls=ExportCommand)
def export(
    run: Annotated[Path, typer.Argument(help="run folder")],
    target: Annotated[Path, typer.Argument(help="file to write, or folder")],
    max_error: Annotated[
        float | None, typer.Option(help="fewer triangles, none farther off than this, in the run's unit")
    ] = None,
    texture: Annotated[bool, typer.Option(help="colours as a picture laid over the mesh; .glb and .obj")] = False,
    nerfstudio: Annotated[bool, typer.Option("--nerfstudio", help="a folder with transforms.json")] = False,
    colmap: Annotated[bool, typer.Option("--colmap", help="a folder with a COLMAP model of pinhole pictures")] = False,
    slicer: Annotated[bool, typer.Option("--slicer", help="a folder with mesh and markups for 3D Slicer")] = False,
    climb: Annotated[bool, typer.Option("--climb", help="a folder as CLiMB's submissions have it")] = False,
) -> None:
    """Write a run's mesh in another format, or the whole run for another program."""
    given_paths.must_be_run(run)
    given_paths.must_be_outside(target, run)
    given_paths.must_have_folder(target)
    from pipeline.climb import write_submission
    from pipeline.report.exporters import export_folder, export_run

    programs = {"nerfstudio": nerfstudio, "colmap": colmap, "slicer": slicer, "climb": climb}
    chosen = [name for name, wanted in programs.items() if wanted]
    if len(chosen) + (max_error is not None or texture) > 1:
        raise HaustraError("give one of --nerfstudio, --colmap, --slicer and --climb, and with it no option of a mesh")
    if climb:
        print(write_submission(run, target))
    else:
        print(export_folder(run, target, chosen[0]) if chosen else export_run(run, target, max_error, texture))


@app.command()
def compare(
    run: Annotated[Path, typer.Argument(help="run folder")],
    truth: Annotated[
        Path, typer.Argument(help="RGB-D folder, TUM trajectory, or folder of C3VD, SimCol3D, EndoMapper-sim")
    ],
    tau_mm: Annotated[float, typer.Option(help="distance of the F-score, in the truth's unit (mm)")] = 1.0,
    protocol: Annotated[
        str, typer.Option(help="haustra; or climb: CLiMB's, one Sim(3) a submap; TRUTH may be images.txt of COLMAP")
    ] = "haustra",
    min_common: Annotated[int, typer.Option(min=3, help="climb: frames that a submap must share with TRUTH")] = 100,
    json_file: Annotated[Path | None, typer.Option("--json", help="also write the figures here")] = None,
) -> None:
    """Errors of a run against truth: path (ATE, RTE, ROT) and surface (accuracy, completeness, F-score)."""
    given_paths.must_be_run(run)
    given_paths.must_exist(truth)
    given_paths.must_have_folder(json_file)
    given_paths.must_be_no_folder(json_file)
    from pipeline.climb import compare_climb
    from pipeline.compare import compare_run
    from pipeline.run_folder.workspace import write_json

    if protocol not in ("haustra", "climb"):
        raise HaustraError(f"--protocol is haustra or climb, not {protocol!r}")
    result = compare_climb(run, truth, min_common) if protocol == "climb" else compare_run(run, truth, tau_mm)
    print(result)
    if json_file is not None:
        write_json(json_file, result.to_dict())


@app.command()
def phantom(
    out: Annotated[Path, typer.Argument(help="folder to write; with --gallery a .png or .jpg file")],
    scene: Annotated[str | None, typer.Option(help="colon, small_intestine, ccd or csd")] = None,
    seed: Annotated[int | None, typer.Option(min=0, help="of geometry, texture, path and noise")] = None,
    frames: Annotated[int | None, typer.Option(min=1, help="length of the film")] = None,
    size: Annotated[int | None, typer.Option(help="side of the square picture, px")] = None,
    motion: Annotated[str | None, typer.Option(help="withdrawal, insertion or loop")] = None,
    events: Annotated[bool, typer.Option("--events", help="red-out, water jet, bubbles, tool, peristalsis")] = False,
    config: Annotated[Path | None, typer.Option(help="YAML file of settings; with --suite, of sequences")] = None,
    suite: Annotated[bool, typer.Option("--suite", help="the five evaluation sequences instead")] = False,
    living_suite: Annotated[
        bool, typer.Option("--living-suite", help="films of moving walls, real hands and real lenses instead")
    ] = False,
    recordings: Annotated[Path, typer.Option(help="folder of the camera paths that --living-suite names")] = Path(),
    training: Annotated[int | None, typer.Option(min=1, help="this many random training frames instead")] = None,
    gallery: Annotated[bool, typer.Option("--gallery", help="a picture of all scenes instead")] = False,
    workers: Annotated[int, typer.Option(min=1, help="processes that render training frames")] = 2,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace the phantom in the folder")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="print nothing but errors")] = False,
) -> None:
    """Make a colon that knows its truth and film it: video, depth, path, mesh, lesions."""
    from haustra.core.progress import SilentProgress, TerminalProgress
    from haustra.phantom.dataset.suite import LIVING_FILE, SUITE_FILE
    from pipeline.cli.phantom import PhantomOptions, chosen_config, render, render_training, suite_folders

    progress = SilentProgress() if quiet else TerminalProgress()
    options = PhantomOptions(scene, seed, frames, size, motion, events, config)
    if sum([suite, living_suite, training is not None, gallery]) > 1:
        raise HaustraError("give only one of --suite, --living-suite, --training and --gallery")
    if gallery:
        from haustra.phantom.dataset.gallery import write_gallery

        with progress.bar("gallery", None) as advance:
            print(write_gallery(out, advance))
    elif training is not None:
        print(render_training(out, training, options, workers, progress))
    elif suite or living_suite:
        if options != PhantomOptions(config=config):
            raise HaustraError("a suite is fixed: it takes --config FILE, --recordings, --overwrite and --quiet only")
        films = suite_folders(out, config or (LIVING_FILE if living_suite else SUITE_FILE))
        print(*render(films, progress, overwrite, recordings), sep="\n")
    else:
        print(*render({out: chosen_config(options)}, progress, overwrite, recordings))


@app.command()
def evaluate(
    folders: Annotated[list[Path], typer.Argument(help="folders with true depth; see completion/data/readers.py")],
    model: Annotated[
        list[str] | None, typer.Option(help="shipped name, weight file, nearest, linear, ip_basic")
    ] = None,
    sampler: Annotated[list[str] | None, typer.Option(help="uniform, by_chance, features, sfm; repeatable")] = None,
    points: Annotated[list[int] | None, typer.Option(min=1, help="per frame; repeat it for a sweep")] = None,
    align: Annotated[str, typer.Option(help="scale: none, points, median or least_squares")] = "none",
    averaging: Annotated[str, typer.Option(help="per_frame (the paper's lineage) or pooled")] = "per_frame",
    dataset: Annotated[str | None, typer.Option(help="layout, if it is not recognised")] = None,
    stride: Annotated[int, typer.Option(min=1, help="every n-th frame")] = 1,
    depth_step: Annotated[
        float, typer.Option(min=0, help="truth is stored in steps of this length (SimCol3D: 0.784314 mm): smooth them")
    ] = 0.0,
    seed: Annotated[int, typer.Option(min=0, help="of the points")] = 0,
    csv: Annotated[Path | None, typer.Option(help="errors of each frame")] = None,
    json_file: Annotated[Path | None, typer.Option("--json", help="everything, with its protocol")] = None,
    sheet: Annotated[Path | None, typer.Option(help="plot: images, truth, completed, error maps")] = None,
    sweep: Annotated[Path | None, typer.Option(help="plot: error over the number of points")] = None,
    calibration: Annotated[Path | None, typer.Option(help="plot: actual over predicted error")] = None,
    compare: Annotated[Path | None, typer.Option(help="plot: the models side by side")] = None,
    attention: Annotated[Path | None, typer.Option(help="plot: features before and after attention")] = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="no progress")] = False,
) -> None:
    """Depth completion against truth: RMSE, abs.REL, MAE, delta 1 and 2, per frame and in mean."""
    given_paths.must_exist(*folders)
    from completion.evaluation.run import Outputs, protocol_of
    from completion.evaluation.run import evaluate as run
    from haustra.core.progress import SilentProgress, TerminalProgress

    protocols = [
        protocol_of(name, count, align, averaging, seed, stride, depth_step)
        for name in sampler or ["uniform"]
        for count in points or [100]
    ]
    progress = SilentProgress() if quiet else TerminalProgress()
    outputs = Outputs(csv, json_file, sheet, sweep, calibration, compare, attention)
    print(run(folders, model or ["linear", "mscsa"], protocols, outputs, dataset, progress))


@app.command()
def train(
    shards: Annotated[list[Path], typer.Argument(help="folders made by haustra phantom --training")],
    out: Annotated[Path, typer.Option(help="weights.safetensors; OUT.checkpoint beside it")],
    model: Annotated[str | None, typer.Option(help="a name of networks/registry.py", show_default="mscsa-sfm")] = None,
    preset: Annotated[str | None, typer.Option(help="paper: Adam 1e-3, L1, batch 10, 100 uniform points")] = None,
    size: Annotated[str | None, typer.Option(help="paper, small, same-parameters", show_default="paper")] = None,
    steps: Annotated[int | None, typer.Option(help="of the optimizer", show_default="12000")] = None,
    batch: Annotated[int | None, typer.Option(help="frames per step", show_default="8")] = None,
    init: Annotated[Path | None, typer.Option(help="weights to begin with")] = None,
    iterations: Annotated[
        int | None,
        typer.Option("--iterations", "--looks", help="most per frame, of mscsa-sfm (--looks: old)", show_default="3"),
    ] = None,
    learning_rate: Annotated[float | None, typer.Option(help="peak; preset paper: 0.001", show_default="0.002")] = None,
    warm_up: Annotated[int | None, typer.Option(help="steps until the peak", show_default="300")] = None,
    seed: Annotated[int | None, typer.Option(help="of weights, order and points", show_default="0")] = None,
    threads: Annotated[int | None, typer.Option(help="of the CPU", show_default="2")] = None,
    device: Annotated[str | None, typer.Option(help="auto, cpu or cuda", show_default="auto")] = None,
    draw_on: Annotated[str | None, typer.Option(help="random numbers: cpu or device", show_default="cpu")] = None,
) -> None:
    """Train a completion network; called again with the same arguments it goes on from its last checkpoint."""
    given_paths.must_exist(*shards, init)
    from completion.training.config import make_config
    from completion.training.train import train as run
    from haustra.core.progress import TerminalProgress

    given: dict[str, Any] = {"model": model, "size": size, "steps": steps, "batch": batch, "init": init, "seed": seed}
    given |= {"iterations": iterations, "learning_rate": learning_rate, "warm_up": warm_up, "threads": threads}
    given |= {"device": device, "draw_on": draw_on}
    config = make_config(preset, shards=tuple(shards), out=out, **{k: v for k, v in given.items() if v is not None})
    progress = TerminalProgress()
    with progress.bar(f"training {config.model}", config.steps) as advance:
        print(run(config, advance, progress.log))


@app.command()
def onnx(
    out: Annotated[Path, typer.Argument(help="model.onnx")],
    model: Annotated[str, typer.Option(help="mscsa, or a weight file of ours for SfM points")] = "mscsa",
    side: Annotated[int, typer.Option(help="of the square image, px; a multiple of 32")] = 320,
    recurrent: Annotated[
        bool,
        typer.Option("--recurrent", "--again", help="the graph of iterations after the first (--again: deprecated)"),
    ] = False,
) -> None:
    """Write a completion network for programs without torch."""
    from completion.inference.completer import load_depth_network
    from completion.inference.onnx_export import export_onnx

    print(export_onnx(load_depth_network(model), out, side, recurrent))


def run_cleanly(command: Callable[[], Any]) -> int:
    """Run a command; known failures become one sentence on standard error and exit code 1."""
    logging.basicConfig(level=logging.WARNING, format="%(levelname)s %(name)s: %(message)s")
    keep_freed_memory()
    try:
        refuse_shadowed_names()
        given_paths.no_empty_words(sys.argv[1:])
        command()
    except HaustraError as error:
        print(f"error: {error}", file=sys.stderr)
        return 1
    except KeyboardInterrupt:
        print(f"stopped; {KEPT}", file=sys.stderr)
        return INTERRUPTED
    except OSError as error:
        if error.errno not in FILE_SYSTEM_SAYS_NO:
            raise
        where = f" ({error.filename})" if error.filename else ""
        print(f"error: {os.strerror(error.errno)}{where}; mend that: {KEPT}", file=sys.stderr)
        return 1
    finally:
        gc.freeze()  # or the interpreter, as it ends, looks for cycles among the 400,000 objects that libraries have
    return 0


def main() -> None:
    """Entry point of `haustra`."""
    sys.exit(run_cleanly(lambda: _checked(app)))


def reconstruct_main() -> None:
    """Entry point of `reconstruct`, the same as `haustra reconstruct`."""
    single = typer.Typer(add_completion=False, **PLAIN)
    single.command()(cli_runs.reconstruct)
    sys.exit(run_cleanly(lambda: _checked(single)))


def _checked(typer_app: typer.Typer) -> None:
    """Typer prints usage errors and exits by itself; a Ctrl-C that it turned into an exit is one again."""
    try:
        typer_app(standalone_mode=True)
    except SystemExit as stop:
        if stop.code == INTERRUPTED:
            raise KeyboardInterrupt from stop
        raise
