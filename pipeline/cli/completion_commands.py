"""The commands about completion networks by themselves: `haustra evaluate`, `haustra train` and `haustra onnx`."""

from pathlib import Path
from typing import Annotated, Any

import typer

from pipeline.cli import given_paths


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
    from completion.evaluation.outputs import Outputs
    from completion.evaluation.run import evaluated_tables, protocol_of
    from haustra.core.progress import SilentProgress, TerminalProgress

    protocols = [
        protocol_of(name, count, align, averaging, seed, stride, depth_step)
        for name in sampler or ["uniform"]
        for count in points or [100]
    ]
    progress = SilentProgress() if quiet else TerminalProgress()
    files = Outputs(csv, json_file, sheet, sweep, calibration, compare, attention)
    for table in evaluated_tables(folders, model or ["linear", "mscsa"], protocols, files, dataset, progress):
        print(table, end="\n\n", flush=True)  # each as it is made, so that an error leaves those before it


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
    given_paths.must_be_no_folder(out)
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
    given_paths.must_have_folder(out)
    given_paths.must_be_no_folder(out)
    from completion.inference.completer import load_depth_network
    from completion.inference.onnx_export import export_onnx

    print(export_onnx(load_depth_network(model), out, side, recurrent))
