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

import torch

from benchmarks.common.record import ROOT, environment
from benchmarks.paper.claims import SCENE_NAMES
from benchmarks.paper.frames import judged_frames, plans
from benchmarks.paper.judgements import FIGURE_5 as EARLY_FUSION
from benchmarks.paper.judgements import NAMES, row
from benchmarks.paper.plan import POINTS, RIVALS, SCENES, Run
from benchmarks.paper.records import FIGURES
from completion.evaluation.evaluate import FrameResult, Protocol, evaluate_frames
from completion.evaluation.plots import attention_plot, comparison_plot
from completion.evaluation.predictors import load_predictor
from completion.networks.channel_attention import StructureAwareness, attention_features
from completion.training.config import TrainConfig

PICTURES = ROOT / "docs/pictures"
SHOWN = ("linear", *RIVALS, "mscsa-plain", "mscsa-early-fusion", "mscsa-plain+residual")
EVERY = 8  # so many judged frames apart are those on which SA is measured
MOST_MM = TrainConfig(shards=(), out=Path()).max_depth_mm


def weights(work: Path, model: str, run: Run) -> Path:
    """Weight file of a run, or the name of a method without weights."""
    return Path(model) if model == "linear" else work / "runs" / f"{run.name}.safetensors"


def middle_frame(work: Path, scene: str, model: Path) -> FrameResult:
    """What a network makes of the middle judged frame of a scene, which is named by it."""
    plan = plans(work, scene)[1]
    frames = list(islice(judged_frames(plan.folder, MOST_MM), plan.frames // 2, plan.frames // 2 + 1))
    result = next(iter(evaluate_frames(frames, load_predictor(model), Protocol(points=POINTS))))
    return replace(result, name=SCENE_NAMES[scene])


def figure_4(work: Path, folder: Path) -> dict[str, Any]:
    """All networks on the four scenes; returns abs.REL of each picture, a fraction."""
    results = {
        NAMES.get(model, "linear interpolation").replace(", ", ",\n"): [
            middle_frame(work, scene, weights(work, model, row(model))) for scene in SCENES
        ]
        for model in SHOWN
    }
    comparison_plot(
        folder / "paper_figure_4.jpg", results, f"{POINTS} uniform points, 160 px, one network for four scenes"
    )
    named = zip(SHOWN, results.values(), strict=True)
    return {model: {r.name: round(r.errors.abs_rel, 5) for r in of} for model, of in named}


def figure_6(work: Path, folder: Path) -> list[str]:
    """Features before and after SA in the paper's two scenes; returns the weights' names."""
    frames, names = [], []
    for scene in ("colon", "small_intestine"):
        path = weights(work, EARLY_FUSION, Run((scene,), EARLY_FUSION))
        plan, predictor = plans(work, scene)[1], load_predictor(path)
        assert predictor.network is not None
        for place in (plan.frames // 4, plan.frames // 2, 3 * plan.frames // 4):
            frame = list(islice(judged_frames(plan.folder, MOST_MM), place, place + 1))
            kept: list[FrameResult] = []
            features = attention_features(
                predictor.network,
                lambda frame=frame, kept=kept, predictor=predictor: kept.extend(
                    evaluate_frames(frame, predictor, Protocol(points=POINTS))
                ),
            )
            assert features is not None
            before, after = (part.numpy() for part in features)
            frames.append((replace(kept[0], name=SCENE_NAMES[scene]), before, after))
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
    network = predictor.network
    assert network is not None
    module = next(module for module in network.modules() if isinstance(module, StructureAwareness))
    figures = []
    for frame in islice(judged_frames(plans(work, scene)[1].folder, MOST_MM), 0, None, EVERY):
        found = attention_features(
            network, lambda frame=frame: list(evaluate_frames([frame], predictor, Protocol(points=POINTS)))
        )
        assert found is not None
        before, after = (features.flatten(1) for features in found)
        values = torch.linalg.svdvals(after - before) ** 2
        largest = module.attention(before[None]).amax(dim=2).mean() * len(before)
        figures.append([(after - before).norm() / before.norm(), values[0] / values.sum(), largest])
    means = torch.tensor(figures).mean(dim=0).tolist()
    return dict(zip(("added", "one_map", "largest_weight"), means, strict=True))


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
        "sa_change": {
            scene: {model: change_by_sa(arguments.work, scene, model) for model in (EARLY_FUSION, "mscsa-plain")}
            for scene in ("colon", "small_intestine")
        },
    }
    drawn["weights"] = {
        path.name: hashlib.sha256(path.read_bytes()).hexdigest()[:12]
        for path in sorted((arguments.work / "runs").glob("*-0.safetensors"))
        if path.stem in {row(model).name for model in SHOWN} or path.name in drawn["figure_6_weights"]
    }
    arguments.json.write_text(json.dumps(drawn, indent=2) + "\n")


if __name__ == "__main__":
    main()
