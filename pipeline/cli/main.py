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
from pipeline.cli import completion_commands, given_paths
from pipeline.cli import run_commands as cli_runs
from pipeline.cli.climb import climb
from pipeline.cli.doctor import doctor
from pipeline.cli.live import live
from pipeline.cli.shadowing import refuse_shadowed_names
from pipeline.run_folder.malloc import keep_freed_memory

OF_FILE_SYSTEM = ("ENOSPC", "EACCES", "EROFS", "EDQUOT", "EFBIG", "ENOENT", "ENOTDIR", "EISDIR", "ENAMETOOLONG")
FILE_SYSTEM_SAYS_NO: tuple[int, ...] = tuple(getattr(errno, name) for name in OF_FILE_SYSTEM)
INTERRUPTED = 130  # the shell's code for Ctrl-C
GO_ON_BY_THEMSELVES = ("batch", "phantom", "train")
# Help is plain text: rich's boxes take as long to load as all else.
PLAIN: dict[str, Any] = {"rich_markup_mode": None, "context_settings": {"max_content_width": 120}}

os.environ.setdefault("OPENCV_LOG_LEVEL", "ERROR")  # of files that cannot be read there is a sentence of our own

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
        *first, last = (f"--{name}" for name in programs)
        raise HaustraError(f"give one of {', '.join(first)} and {last}, and with it no option of a mesh")
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
        str, typer.Option(help="haustra; or climb: CLiMB's, one Sim(3) a submap; TRUTH may be a COLMAP model")
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


for of_network in (completion_commands.evaluate, completion_commands.train, completion_commands.onnx):
    app.command()(of_network)


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
    except KeyboardInterrupt as stop:
        print(f"stopped; {_way_on(stop)}", file=sys.stderr)
        return INTERRUPTED
    except OSError as error:
        if error.errno not in FILE_SYSTEM_SAYS_NO:
            raise
        where = f" ({error.filename})" if error.filename else ""
        print(f"error: {os.strerror(error.errno)}{where}; mend that: {_way_on(error)}", file=sys.stderr)
        return 1
    finally:
        _leave_no_tensors()
        gc.freeze()  # or the interpreter, as it ends, looks for cycles among the 400,000 objects that libraries have
    return 0


def _way_on(error: BaseException | None) -> str:
    """What to do after a command that was cut short: as the run folder that it had begun says in a note, if any."""
    while error is not None:
        for note in getattr(error, "__notes__", ()):
            return str(note)
        error = error.__cause__ or error.__context__
    kept = "what was finished is kept: the same command goes on"
    return kept if sys.argv[1:2] and sys.argv[1] in GO_ON_BY_THEMSELVES else "give the command again"


def _leave_no_tensors() -> None:
    """Free what only cycles hold: Open3D ends a process with exit code 1 if one of its tensors is left."""
    if "open3d" in sys.modules:
        gc.collect()


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
