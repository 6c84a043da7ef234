"""The paper's Tables I and II on the phantom's scenes: every network trained on the same frames in the same order.

    haustra phantom DATA/colon --training 4000 --scene colon --size 160 --seed 51   # small_intestine 52, ccd 53, csd 54
    python -m benchmarks.paper_tables 2 DATA/colon DATA/small_intestine --out RUNS --steps 3000 --seeds 2
    python -m benchmarks.paper_tables 1 DATA/* --joint --out RUNS --steps 3000

Paper's preset: Adam 1e-3, L1, batch 10, 100 uniform points; for the last 30 % of the steps a tenth of the rate,
as "a decaying factor of 10" is read here: a short run that ends at the full rate is judged at a random moment.
Each network of `--size small` (what that cuts is in networks/registry.py) or `paper`. Each scene is trained for itself,
as in the paper, or with `--joint` one network for all of them. Judged on meshes that were never trained on, 100 uniform
points, each frame on its own, then the mean over frames (the paper's lineage); then mean and spread over seeds. Linear
interpolation, which needs no training, is the floor. "residual": the U-Net corrects MSC's depth, which is not in the
paper (completion/networks/mscsa.py). A stopped run goes on where it was, unless the frames are others than then.
"""

import argparse
import hashlib
import json
import sys
import time
from collections.abc import Iterator, Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.record import write
from benchmarks.common.runner import add_seeds, run
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.shards import Shard
from completion.evaluation.accumulator import Accumulator
from completion.evaluation.evaluate import Protocol, evaluate_frames, markdown_table, mean_errors
from completion.evaluation.predictors import Predictor, load_predictor
from completion.training.config import TrainConfig, make_config
from completion.training.train import train

ROWS = {
    1: {
        "StD-ResNet18": "std18",
        "StD-ResNet50": "std50",
        "GAENet": "gaenet",
        "NLSPN": "nlspn",
        "MSCSA-Net": "mscsa",
        "MSCSA-Net, residual": "mscsa+residual",
    },
    2: {
        "baseline": "unet",
        "+SA": "unet+sa",
        "+MSC": "unet+msc",
        "full": "mscsa",
        "+MSC, residual": "unet+msc+residual",
        "full, residual": "mscsa+residual",
        "full, residual, SA of like channels": "mscsa+residual+similar",
    },
}
ONLY_NAMED = {"full, residual, SA of like channels"}  # rows that are not the paper's, nor needed beside it
DECAY_AT = 0.7
FIGURES = ("rmse", "abs_rel", "mae", "delta_1", "delta_2")


def held_out_frames(folder: Path, most_mm: float) -> Iterator[EvaluationFrame]:
    """Every frame of the meshes that training leaves out; truth beyond `most_mm` is left out, as in training."""
    shard = Shard.open(folder)
    for index in shard.split()[1]:
        depth = shard.depths[index].astype(np.float32)
        lens = None if shard.lenses is None else shard.lenses[index].astype(float)
        yield EvaluationFrame(
            str(index), np.array(shard.images[index]), np.where(depth < most_mm, depth, 0), "mm", lens
        )


def trained(folders: Sequence[Path], model: str, seed: int, arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Train one network on these scenes and judge it on each; the record is kept beside its weights."""
    scenes = "_".join(folder.name for folder in folders)
    points = "" if arguments.points == 100 else f"_{arguments.points}points"
    name = f"{scenes}_{model}_{arguments.size}_{arguments.steps}_{seed}{points}_{digest(folders)}".replace("+", "_")
    record = arguments.out / f"{name}.json"
    if record.exists():
        return json.loads(record.read_text())
    config = make_config(
        "paper",
        shards=tuple(folders),
        out=arguments.out / f"{name}.safetensors",
        model=model,
        size=arguments.size,
        steps=arguments.steps,
        points=arguments.points,
        seed=seed,
        threads=arguments.threads,
        decay_at=DECAY_AT,
    )
    start = time.monotonic()
    weights = train(config, say=lambda text: print(f"{name}: {text}", flush=True))
    predictor, minutes = load_predictor(weights), (time.monotonic() - start) / 60
    figures = [
        {**judged(folder, predictor, config), "model": model, "seed": seed, "minutes": minutes / len(folders)}
        for folder in folders
    ]
    record.write_text(json.dumps(figures, indent=1) + "\n")
    return figures


def judged(folder: Path, predictor: Predictor, config: TrainConfig) -> dict[str, Any]:
    """Mean errors on the scene's held-out meshes."""
    protocol = Protocol(points=config.points)
    accumulator = Accumulator().add_all(
        evaluate_frames(held_out_frames(folder, config.max_depth_mm), predictor, protocol)
    )
    mean = mean_errors(accumulator.scores, protocol).to_dict()
    return {"folder": folder.name, "frames": len(accumulator.scores), **{key: mean[key] for key in FIGURES}}


def digest(folders: Sequence[Path]) -> str:
    """Of how the frames were drawn and of the first of them, so that figures of others are not taken for theirs."""
    found = hashlib.sha256()
    for folder in folders:
        found.update((folder / "shards.json").read_bytes())
        found.update(Shard.open(folder).depths[0].tobytes())
    return found.hexdigest()[:8]


def refuse_shared_meshes(folders: Sequence[Path]) -> None:
    """Scenes of one seed share anatomies, so that one's held-out meshes would be another's to train on."""
    seeds = [json.loads((folder / "shards.json").read_text())["seed"] for folder in folders]
    if len(set(seeds)) < len(seeds) or len({folder.name for folder in folders}) < len(folders):
        raise SystemExit("error: render each scene with a seed of its own, into folders of different names")


def cell(figures: list[dict[str, Any]], key: str) -> str:
    """Mean over seeds, and half their spread where there are several."""
    factor = 100 if key == "abs_rel" else 1
    values = factor * np.array([figure[key] for figure in figures])
    spread = f" +-{np.ptp(values) / 2:.3f}" if len(values) > 1 else ""
    return f"{values.mean():.4f}{spread}"


def table(scene: str, rows: dict[str, str], figures: list[dict[str, Any]]) -> str:
    """One scene's rows as the paper lays them out."""
    heads = {"rmse": "RMSE [mm]", "abs_rel": "abs.REL [%]", "mae": "MAE [mm]"}
    here = [figure for figure in figures if figure["folder"] == scene]
    cells = []
    for label, model in rows.items():
        of_model = [figure for figure in here if figure["model"] == model]
        cells.append((label, {heads.get(key, key): cell(of_model, key) for key in FIGURES}))
    return f"**{scene}** ({here[0]['frames']} frames of meshes never trained on)\n\n{markdown_table(cells)}"


def chosen_rows(number: int, labels: list[str] | None) -> dict[str, str]:
    """Rows of a table and their networks; the paper's and what goes with them, or those of these labels."""
    rows = ROWS[number]
    if unknown := set(labels or ()) - set(rows):
        raise SystemExit(f"error: no row {', '.join(sorted(unknown))} in Table {number}: give one of {', '.join(rows)}")
    return {label: model for label, model in rows.items() if label in (labels or rows.keys() - ONLY_NAMED)}


def floor(arguments: argparse.Namespace) -> list[dict[str, Any]]:
    """Linear interpolation on each scene."""
    predictor = load_predictor("linear")
    shared = {"model": "linear", "seed": None, "minutes": 0.0}
    config = make_config("paper", shards=tuple(arguments.folders), out=arguments.out, points=arguments.points)
    return [{**judged(folder, predictor, config), **shared} for folder in arguments.folders]


def budget_of(arguments: argparse.Namespace) -> str:
    """What every network of a table was given alike."""
    scenes = "all scenes together" if arguments.joint else "each scene alone"
    trainings = f"{arguments.steps} steps of 10 frames, {arguments.seeds} seeds, size {arguments.size}"
    return f"{trainings}, {arguments.points} points, {scenes}, {arguments.threads} threads"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("table", type=int, choices=ROWS, help="1: all networks; 2: MSCSA-Net's ablation")
    parser.add_argument("folders", type=Path, nargs="+", help="training frames of one scene each")
    parser.add_argument("--out", type=Path, required=True, help="folder of weights, checkpoints and tables")
    parser.add_argument("--joint", action="store_true", help="one network for all scenes instead of one for each")
    parser.add_argument("--steps", type=int, default=3000, help="of each training, 10 frames each")
    add_seeds(parser, 2)
    parser.add_argument(
        "--points", type=int, default=100, help="per frame, in training and judging; the paper's are 100"
    )
    parser.add_argument("--row", action="append", help="only this row of the table, by its label; again for more")
    parser.add_argument("--size", choices=["paper", "small"], default="small", help="of the networks")
    parser.add_argument("--threads", type=int, default=2, help="of the CPU")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Train and judge every row with every seed; text and record also go into `--out`."""
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows = chosen_rows(arguments.table, arguments.row)
    refuse_shared_meshes(arguments.folders)
    groups = [arguments.folders] if arguments.joint else [[folder] for folder in arguments.folders]
    figures = floor(arguments)
    for seed, folders, model in product(range(arguments.seeds), groups, rows.values()):
        figures += trained(folders, model, seed, arguments)
    budget, minutes = budget_of(arguments), sum(figure["minutes"] for figure in figures)
    tables = [table(folder.name, {**rows, "(linear)": "linear"}, figures) for folder in arguments.folders]
    text = f"Table {arguments.table}: {budget}, {minutes:.0f} minutes in all\n\n" + "\n\n".join(tables) + "\n"
    print(text)
    part = "_".join(["", *rows.values()]).replace("+", "_") if arguments.row else ""
    (arguments.out / f"table{arguments.table}{part}.md").write_text(text)
    record = {"budget": budget, "minutes": minutes, "figures": figures}
    write(arguments.out / f"table{arguments.table}{part}.json", record)
    return record


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.paper_tables")
