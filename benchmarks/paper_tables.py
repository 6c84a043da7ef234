"""The paper's Tables I and II on the phantom's scenes: every network trained on the same frames in the same order.

    haustra phantom DATA/colon --training 4000 --scene colon --size 160           # likewise small_intestine, ccd, csd
    python benchmarks/paper_tables.py 2 DATA/colon DATA/small_intestine --out RUNS --steps 3000 --seeds 2
    python benchmarks/paper_tables.py 1 DATA/colon DATA/small_intestine DATA/ccd DATA/csd --out RUNS --steps 3000

Paper's preset: Adam 1e-3, L1, batch 10, 100 uniform points; each network of `--size small` (what that cuts is in
completion/models.py) or `paper`. Judged on meshes that were never trained on, 100 uniform points, each frame on its
own, then the mean over frames (the paper's lineage); then mean and spread over seeds. A stopped run goes on where it
was.
"""

import argparse
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from completion.dataset import Shard
from completion.evaluate import Protocol, evaluate_frames, markdown_table, mean_errors
from completion.frames import EvaluationFrame
from completion.predictors import load_predictor
from completion.train import train
from completion.train_config import make_config
from record import environment

ROWS = {
    1: {"StD-ResNet18": "std18", "StD-ResNet50": "std50", "GAENet": "gaenet", "NLSPN": "nlspn", "MSCSA-Net": "mscsa"},
    2: {"baseline": "unet", "+SA": "unet+sa", "+MSC": "unet+msc", "full": "mscsa"},
}
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


def one_figure(folder: Path, model: str, seed: int, arguments: argparse.Namespace) -> dict[str, Any]:
    """Train and judge one network; the record is kept beside its weights."""
    name = f"{folder.name}_{model}_{arguments.size}_{arguments.steps}_{seed}".replace("+", "_")
    record = arguments.out / f"{name}.json"
    if record.exists():
        return json.loads(record.read_text())
    config = make_config(
        "paper",
        shards=(folder,),
        out=arguments.out / f"{name}.safetensors",
        model=model,
        size=arguments.size,
        steps=arguments.steps,
        seed=seed,
        threads=arguments.threads,
    )
    start = time.monotonic()
    weights = train(config, say=lambda text: print(f"{name}: {text}", flush=True))
    frames = list(held_out_frames(folder, config.max_depth_mm))
    results = list(evaluate_frames(frames, load_predictor(weights), Protocol(points=config.points)))
    mean = mean_errors(results, Protocol(points=config.points)).to_dict()
    figure = {"folder": folder.name, "model": model, "seed": seed, "frames": len(frames), "steps": config.steps}
    figure |= {"minutes": (time.monotonic() - start) / 60, **{key: mean[key] for key in FIGURES}}
    record.write_text(json.dumps(figure, indent=1) + "\n")
    return figure


def cell(figures: list[dict[str, Any]], key: str) -> str:
    """Mean over seeds, and half their spread where there are several."""
    factor = 100 if key == "abs_rel" else 1
    values = factor * np.array([figure[key] for figure in figures])
    spread = f" +-{np.ptp(values) / 2:.3f}" if len(values) > 1 else ""
    return f"{values.mean():.4f}{spread}"


def table(folder: Path, rows: dict[str, str], figures: dict[str, list[dict[str, Any]]]) -> str:
    heads = {"rmse": "RMSE [mm]", "abs_rel": "abs.REL [%]", "mae": "MAE [mm]"}
    cells = [(label, {heads.get(k, k): cell(figures[model], k) for k in FIGURES}) for label, model in rows.items()]
    held_out = next(iter(figures.values()))[0]["frames"]
    return f"**{folder.name}** ({held_out} frames of meshes never trained on)\n\n{markdown_table(cells)}"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("table", type=int, choices=ROWS)
    parser.add_argument("folders", type=Path, nargs="+", help="training frames of one scene each")
    parser.add_argument("--out", type=Path, required=True)
    parser.add_argument("--steps", type=int, default=3000)
    parser.add_argument("--seeds", type=int, default=2)
    parser.add_argument("--size", choices=["paper", "small"], default="small")
    parser.add_argument("--threads", type=int, default=2)
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    rows, tables, everything = ROWS[arguments.table], [], []
    for folder in arguments.folders:
        figures = {m: [one_figure(folder, m, s, arguments) for s in range(arguments.seeds)] for m in rows.values()}
        everything += [figure for several in figures.values() for figure in several]
        tables.append(table(folder, rows, figures))
        print(tables[-1], flush=True)
    budget = f"{arguments.steps} steps of 10 frames, {arguments.seeds} seeds, size {arguments.size}"
    minutes = sum(figure["minutes"] for figure in everything)
    text = f"Table {arguments.table}: {budget}, {minutes:.0f} minutes in all\n\n" + "\n\n".join(tables) + "\n"
    (arguments.out / f"table{arguments.table}.md").write_text(text)
    record = {"environment": environment(), "budget": budget, "minutes": minutes, "figures": everything}
    (arguments.out / f"table{arguments.table}.json").write_text(json.dumps(record, indent=1) + "\n")


if __name__ == "__main__":
    main()
