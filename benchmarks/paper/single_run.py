"""One run of the plan: train, judge on meshes never trained on, write the record."""

import hashlib
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from benchmarks.paper.batch_statistics import companion_effect
from benchmarks.paper.frames import judged_frames, render
from benchmarks.paper.plan import FLOAT32, TRAINED_ON, UNTRAINED, Run
from completion.evaluation.evaluate import FrameResult, Protocol, evaluate_frames
from completion.evaluation.predictors import Predictor, load_predictor
from completion.networks.checkpoint import load_tensors, read_metadata
from completion.training.config import TrainConfig, make_config
from completion.training.train import train
from haustra.core.errors import CompletionError

FIGURES = ("rmse", "abs_rel", "mae", "delta_1", "delta_2")
FRACTION_DIGITS = 6


def perform(run: Run, work: Path, environment: dict[str, Any]) -> dict[str, Any]:
    """The record of a run: its settings, commit and machine, and each judged frame's errors by scene."""
    folders = {scene: render(work, scene, run.side) for scene in run.scenes}
    config = make_config(
        "paper",
        shards=tuple(training for training, _ in folders.values()),
        out=work / "runs" / f"{run.weights}.safetensors",
        model="unet" if run.model in UNTRAINED else run.model,
        threads=1,
        **run.settings,
    )
    start, wall, before = time.process_time(), time.monotonic(), steps_done(config)
    weights = UNTRAINED.get(run.model) or trained(config, run)
    steps = steps_done(config)
    spent = {"processor_seconds_a_step": time.process_time() - start, "seconds_a_step": time.monotonic() - wall}
    new = 0 if run.model in UNTRAINED else steps - before
    predictor = load_predictor(weights)
    network = predictor.network
    if network and run.change == FLOAT32:
        network.load_state_dict(before_halving(config))
    trained_on = run.change == TRAINED_ON
    try:
        scenes = {
            scene: judged(both[0 if trained_on else 1], predictor, config, trained_on)
            for scene, both in folders.items()
        }
        failed = None
    except CompletionError as error:
        if "no pixel has both" not in str(error):
            raise
        scenes, failed = {}, str(error)  # a network that says zero everywhere has no error to speak of
    about = {"model": run.model, "seed": run.seed, "steps": run.steps, "change": run.change}
    about |= {
        "size": run.size,
        "points": run.points,
        "sampler": run.sampler,
        "converged": run.converged,
        "side": run.side,
    }
    about |= {
        "steps_done": steps,
        "steps_on": steps_on(config),
        "device": str(next(network.parameters()).device.type) if network else "cpu",
    }
    about |= {"settings": json.loads(config.model_dump_json(exclude={"shards", "out", "init", "threads"}))}
    return {
        "environment": environment,
        **about,
        "parameters": sum(p.numel() for p in network.parameters()) if network and run.model not in UNTRAINED else 0,
        **{name: value / new if new else None for name, value in spent.items()},
        "frames_digest": {scene: digest(both) for scene, both in folders.items()},
        "failed": failed,
        "scenes": scenes,
    }


def steps_done(config: TrainConfig) -> int:
    """Steps of an earlier call, whose time is not in this one's."""
    checkpoint = config.out.with_suffix(".checkpoint")
    return read_metadata(checkpoint)["step"] if checkpoint.exists() else 0


def steps_on(config: TrainConfig) -> dict[str, int]:
    """Steps by the device that made them: a run that was stopped can go on elsewhere."""
    checkpoint = config.out.with_suffix(".checkpoint")
    return read_metadata(checkpoint)["steps_on"] if checkpoint.exists() else {}


def before_halving(config: TrainConfig) -> dict[str, Tensor]:
    """A finished run's weights as they were trained; weight files hold half precision."""
    tensors, _ = load_tensors(config.out.with_suffix(".checkpoint"))
    return {name.removeprefix("average."): t for name, t in tensors.items() if name.startswith("average.")}


def trained(config: TrainConfig, run: Run) -> Path:
    """Weights of a finished run, trained now or on from its checkpoint."""
    return (
        config.out if config.out.exists() else train(config, say=lambda text: print(f"{run.name}: {text}", flush=True))
    )


def judged(folder: Path, predictor: Predictor, config: TrainConfig, trained_on: bool = False) -> dict[str, Any]:
    """Errors of every frame, lengths in mm and the rest as fractions, with the mesh that it shows."""
    frames = judged_frames(folder, config.max_depth_mm, trained_on)
    results = evaluate_frames(frames, predictor, Protocol(points=config.points, sampler=config.sampler))
    msc = getattr(predictor.network, "msc", None) if hasattr(predictor.network, "config") else None
    msc = msc if isinstance(msc, nn.Module) and not hasattr(predictor.network, "iterate") else None
    columns: dict[str, list[Any]] = {"mesh": [], **{name: [] for name in FIGURES}}
    columns |= {"pixels": [], "missing": [], "msc_abs_rel": []}
    for result in results:
        columns["mesh"].append(int(result.name))
        for name in FIGURES:
            columns[name].append(round(getattr(result.errors, name), FRACTION_DIGITS))
        columns["pixels"].append(result.errors.pixels)
        columns["missing"].append(result.errors.missing)
        if msc is not None:
            columns["msc_abs_rel"].append(round(msc_error(msc, result, config.unit_mm), FRACTION_DIGITS))
    network = predictor.network
    effect = None if network is None else companion_effect(network, folder, config.unit_mm, config.points)
    return {"frames": columns, "batch_statistics": effect}


def msc_error(msc: nn.Module, result: FrameResult, unit_mm: float) -> float:
    """Mean relative error of the depth that MSC hands to the network, taken as a depth."""
    sparse = torch.from_numpy(np.ascontiguousarray(result.sparse, dtype=np.float32))[None, None] / unit_mm
    sparse = sparse.to(next(msc.parameters()).device)
    with torch.inference_mode():
        depth = msc(sparse, (sparse > 0).float())[0][0, 0].cpu().numpy() * unit_mm
    known = result.truth > 0
    return float(np.mean(np.abs(depth - result.truth)[known] / result.truth[known]))


def digest(folders: tuple[Path, Path]) -> str:
    """Of the first and last depth maps of both folders, so that records of other frames can be told."""
    found = hashlib.sha256()
    for folder in folders:
        depths = np.load(folder / "depths.npy", mmap_mode="r")
        found.update(depths[0].tobytes() + depths[-1].tobytes())
    return found.hexdigest()[:12]
