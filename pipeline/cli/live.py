"""The command `haustra live`."""

from pathlib import Path
from typing import Annotated

import typer

from haustra.core.errors import HaustraError
from pipeline.cli.given_paths import must_be_named_or_exist, must_exist
from pipeline.cli.run_commands import Camera, ConfigFile, Device, LumenMm, Model, Quiet, Seed


def live(
    source: Annotated[
        str | None,
        typer.Argument(help="video or folder, camera number or device, or address (rtsp://, udp://, http://)"),
    ] = None,
    output: Annotated[Path | None, typer.Option("--output", "-o", help="run folder; live_run if not given")] = None,
    camera: Camera = None,
    model: Model = None,
    lumen_mm: LumenMm = None,
    config: ConfigFile = None,
    growing: Annotated[bool, typer.Option("--growing", help="the file is still being written")] = False,
    loops: Annotated[int, typer.Option("--loops", min=1, help="play the film so often")] = 1,
    port: Annotated[int, typer.Option(min=0, help="of the page; 0: a free one")] = 0,
    browser: Annotated[bool, typer.Option("--browser/--no-browser", help="open the page")] = True,
    finish: Annotated[
        bool, typer.Option("--finish/--no-finish", help="reconstruct what was recorded at the end")
    ] = True,
    seed: Seed = None,
    device: Device = None,
    resume: Annotated[bool, typer.Option("--resume", help="finish the run of a session that was stopped")] = False,
    overwrite: Annotated[bool, typer.Option("--overwrite", help="replace what is in the output folder")] = False,
    quiet: Quiet = False,
) -> None:
    """Watch the surface grow while the scope moves; then the run of what was recorded."""
    if (source is None) != resume:
        raise HaustraError("give a source, or --resume with the folder of the session as --output; not both")
    must_exist(config)
    must_be_named_or_exist("--camera", camera)
    must_be_named_or_exist("--model", model)
    from haustra.core.progress import SilentProgress, TerminalProgress

    folder, progress = output or Path("live_run"), SilentProgress() if quiet else TerminalProgress()
    if resume:
        from pipeline.live.finish import finish_run

        finish_run(folder, progress)
        return
    assert source is not None
    from pipeline.config import load_config
    from pipeline.live.live_run import live as run

    settings = load_config(config, camera=camera, model=model, lumen_mm=lumen_mm, seed=seed, device=device)
    run(
        source,
        folder,
        settings,
        progress,
        port=port,
        open_browser=browser,
        loops=loops,
        grows=growing,
        overwrite=overwrite,
        finish=finish,
    )
