"""Draw the paper's Figures 4 and 6 with the networks of seed 0 that the queue has trained.

    python -m benchmarks.paper.figures --work WORK      # docs/pictures/paper_figure_{4,6}.jpg, and their JSON

The frames are the middle ones of each scene's judged frames: nobody chose them by what they show.
"""

import argparse
import hashlib
import json
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from benchmarks.common.record import ROOT, environment
from benchmarks.paper.claims import SCENE_NAMES
from benchmarks.paper.frames import judged_frames, plans
from benchmarks.paper.judgements import FIGURE_5 as EARLY_FUSION
from benchmarks.paper.judgements import NAMES, row
from benchmarks.paper.plan import JUDGED_FRAMES, ONE_SCENE, OURS, POINTS, RIVALS, UNTRAINED, Run
from benchmarks.paper.records import FIGURES
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.sampling_benchmark import like_sfm
from completion.evaluation.evaluate import FrameResult, Protocol, evaluate_frames
from completion.evaluation.plots import attention_plot, comparison_plot
from completion.evaluation.predictors import Predictor, load_predictor
from completion.networks.channel_attention import StructureAwareness, attention_features
from completion.training.config import TrainConfig

PICTURES = ROOT / "docs/pictures"
SHOWN = ("linear", "nearest", *OURS, *RIVALS)  # what is trained of them
EVERY = 8  # so many judged frames apart are those on which SA is measured
MOST_MM = TrainConfig(shards=(), out=Path()).max_depth_mm


def weights(work: Path, model: str, run: Run) -> Path:
    """Weight file of a run, or the name of a method without weights."""
    return Path(model) if model in UNTRAINED else work / "runs" / f"{run.name}.safetensors"


def trained(work: Path) -> dict[str, Path]:
    """Of Figure 4: the networks that are there, by name; where only batches of one scene were trained on, these."""
    found = {}
    for model in SHOWN:
        for change in ("", ONE_SCENE):
            path = weights(work, model, replace(row(model), change=change))
            if model in UNTRAINED or path.exists():
                found.setdefault(model, path)
    return found


def judged_frame(work: Path, scene: str, place: int) -> EvaluationFrame:
    """One of a scene's judged frames, by its place."""
    return next(islice(judged_frames(plans(work, scene)[1].folder, MOST_MM), place, None))


def completed(predictor: Predictor, frame: EvaluationFrame) -> FrameResult:
    """What a network makes of a frame."""
    return next(iter(evaluate_frames([frame], predictor, Protocol(points=POINTS))))


def features_of(predictor: Predictor, frame: EvaluationFrame) -> tuple[Tensor, Tensor]:
    """The deepest features (C,h,w) before and after SA."""
    assert predictor.network is not None
    found = attention_features(predictor.network, lambda: completed(predictor, frame))
    assert found is not None
    return found


def figure_4(work: Path, folder: Path) -> dict[str, Any]:
    """All networks on the four scenes; returns abs.REL of each picture, a fraction."""
    networks = trained(work)
    names = NAMES | {"linear": "linear interpolation", "nearest": "nearest point"}
    results = {
        names[model].replace(", ", ",\n"): [
            replace(completed(load_predictor(path), judged_frame(work, scene, JUDGED_FRAMES // 2)), name=name)
            for scene, name in SCENE_NAMES.items()
        ]
        for model, path in networks.items()
    }
    comparison_plot(
        folder / "paper_figure_4.jpg", results, f"{POINTS} uniform points, 160 px, one network for four scenes"
    )
    named = zip(networks, results.values(), strict=True)
    return {model: {r.name: round(r.errors.abs_rel, 5) for r in of} for model, of in named}


def figure_6(work: Path, folder: Path) -> list[str]:
    """Features before and after SA in the paper's two scenes; returns the weights' names."""
    frames, names = [], []
    for scene in ("colon", "small_intestine"):
        path = weights(work, EARLY_FUSION, Run((scene,), EARLY_FUSION))
        predictor = load_predictor(path)
        for quarter in (1, 2, 3):
            frame = judged_frame(work, scene, quarter * JUDGED_FRAMES // 4)
            before, after = (part.numpy() for part in features_of(predictor, frame))
            frames.append((replace(completed(predictor, frame), name=SCENE_NAMES[scene]), before, after))
        names.append(path.name)
    attention_plot(
        folder / "paper_figure_6.jpg", frames, "three judged frames of the colon, three of the small intestine"
    )
    return names


def change_by_sa(work: Path, scene: str, model: str) -> dict[str, float]:
    """What SA adds to the deepest features, means over every `EVERY`-th judged frame.

    `added`: its norm over that of the features. `one_map`: share of its squared norm that is one map, given to each
    channel with a factor. `largest_weight`: the largest attention of a channel times the number of channels: 1 if all
    are equal.
    """
    predictor = load_predictor(weights(work, model, Run((scene,), model)))
    assert predictor.network is not None
    module = next(module for module in predictor.network.modules() if isinstance(module, StructureAwareness))
    figures = []
    for frame in islice(judged_frames(plans(work, scene)[1].folder, MOST_MM), 0, None, EVERY):
        before, after = (features.flatten(1) for features in features_of(predictor, frame))
        values = torch.linalg.svdvals(after - before) ** 2
        largest = module.attention(before[None]).amax(dim=2).mean() * len(before)
        figures.append([(after - before).norm() / before.norm(), values[0] / values.sum(), largest])
    means = torch.tensor(figures).mean(dim=0).tolist()
    return dict(zip(("added", "one_map", "largest_weight"), means, strict=True))


def keypoints(work: Path) -> dict[str, float]:
    """SIFT keypoints with truth of every `EVERY`-th judged frame of the colon: what feature points can be had."""
    rng, counts = np.random.default_rng(0), []
    for frame in islice(judged_frames(plans(work, "colon")[1].folder, MOST_MM), 0, None, EVERY):
        counts.append(like_sfm(frame.rgb, frame.depth, frame.depth.size, rng).points)
    return {"median": float(np.median(counts)), "least": min(counts), "most": max(counts)}


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.paper.figures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--work", type=Path, required=True, help="folder of the queue's frames and weights")
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="where the pictures go")
    parser.add_argument("--json", type=Path, default=FIGURES, help="what was drawn, with commit")
    arguments = parser.parse_args()
    drawn = {
        "environment": environment(),
        "figure_4_abs_rel": figure_4(arguments.work, arguments.pictures),
        "figure_6_weights": figure_6(arguments.work, arguments.pictures),
        "keypoints": keypoints(arguments.work),
        "sa_change": {
            scene: {model: change_by_sa(arguments.work, scene, model) for model in (EARLY_FUSION, "mscsa-plain")}
            for scene in ("colon", "small_intestine")
        },
    }
    used = {path for path in trained(arguments.work).values() if path.exists()}
    used |= {arguments.work / "runs" / name for name in drawn["figure_6_weights"]}
    drawn["weights"] = {path.name: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in sorted(used)}
    arguments.json.write_text(json.dumps(drawn, indent=2) + "\n")


if __name__ == "__main__":
    main()
