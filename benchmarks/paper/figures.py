"""Draw the paper's Figures 4 and 6 with the networks of seed 0 that the queue has trained.

python -m benchmarks.paper.figures --work WORK               # docs/pictures/paper_figure_{4,6}.jpg, and their JSON
python -m benchmarks.paper.figures --work WORK --figure 4    # one of them; what the JSON says of the other stays
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
from benchmarks.paper import figure_4
from benchmarks.paper.claims import SCENE_NAMES
from benchmarks.paper.figure_4 import EVERY, MOST_MM, completed, frames_of, trained, weights
from benchmarks.paper.frames import judged_frames, plans
from benchmarks.paper.plan import FIGURE_5 as EARLY_FUSION
from benchmarks.paper.plan import JUDGED_FRAMES, UNTRAINED, Run
from benchmarks.paper.records import FIGURES
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.sampling_benchmark import like_sfm
from completion.evaluation.plots import attention_plot
from completion.evaluation.predictors import Predictor, load_predictor
from completion.networks.channel_attention import StructureAwareness, attention_features

PICTURES = ROOT / "docs/pictures"
SCENES = ("colon", "small_intestine")  # of Figure 6


def features_of(predictor: Predictor, frame: EvaluationFrame) -> tuple[Tensor, Tensor]:
    """The deepest features (C,h,w) before and after SA."""
    assert predictor.network is not None
    found = attention_features(predictor.network, lambda: completed(predictor, [frame]))
    assert found is not None
    return found


def figure_6(work: Path, picture: Path) -> list[Path]:
    """Features before and after SA in the paper's two scenes; returns the weight files."""
    frames, paths = [], []
    for scene in SCENES:
        path = weights(work, EARLY_FUSION, Run((scene,), EARLY_FUSION))
        predictor = load_predictor(path)
        for quarter in (1, 2, 3):
            frame = frames_of(work, scene, quarter * JUDGED_FRAMES // 4)[0]
            before, after = (part.numpy() for part in features_of(predictor, frame))
            frames.append((replace(completed(predictor, [frame])[0], name=SCENE_NAMES[scene]), before, after))
        paths.append(path)
    attention_plot(picture, frames, "three judged frames of the colon, three of the small intestine")
    return paths


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
    for frame in frames_of(work, scene, 0, EVERY):
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


def record_of_4(work: Path, pictures: Path) -> dict[str, Any]:
    """Of Figure 4, with its picture."""
    drawn = figure_4.draw(work, pictures / "paper_figure_4.jpg")
    return {"environment": environment(), **drawn, "weights": named(needed(work, "4"))}


def record_of_6(work: Path, pictures: Path) -> dict[str, Any]:
    """Of Figure 6, with its picture."""
    paths = figure_6(work, pictures / "paper_figure_6.jpg")
    change = {
        scene: {model: change_by_sa(work, scene, model) for model in (EARLY_FUSION, "mscsa-plain")} for scene in SCENES
    }
    return {"environment": environment(), "weights": named(paths), "keypoints": keypoints(work), "sa_change": change}


def needed(work: Path, figure: str) -> list[Path]:
    """Weight files of a figure."""
    if figure == "4":
        return [path for model, path in trained(work).items() if model not in UNTRAINED]
    return [weights(work, model, Run((scene,), model)) for scene in SCENES for model in (EARLY_FUSION, "mscsa-plain")]


def refuse_without_weights(work: Path, figures: list[str]) -> None:
    """SystemExit unless all weights are there: a figure without some networks would replace the one with all."""
    for figure in figures:
        paths = needed(work, figure)
        if missing := [path for path in paths if not path.exists()]:
            raise SystemExit(
                f"error: Figure {figure} needs {len(paths)} trained networks; {work / 'runs'} lacks {len(missing)}, "
                f"{missing[0].stem} first; a queue leaves out runs that have a record, so train them with "
                f"`python -m benchmarks.paper --work {work} --results OTHER --table {'1' if figure == '4' else '2'}`"
            )


def named(paths: list[Path]) -> dict[str, str]:
    """Beginning of each file's SHA-256, by name."""
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest()[:12] for path in sorted(paths)}


def main() -> None:
    parser = argparse.ArgumentParser(
        "python -m benchmarks.paper.figures",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    draw = {"4": record_of_4, "6": record_of_6}
    parser.add_argument("--work", type=Path, required=True, help="folder of the queue's frames and weights")
    parser.add_argument("--figure", choices=draw, action="append", help="only this; default: both")
    parser.add_argument("--pictures", type=Path, default=PICTURES, help="where the pictures go")
    parser.add_argument("--json", type=Path, default=FIGURES, help="what was drawn, with commit")
    arguments = parser.parse_args()
    figures = arguments.figure or [*draw]
    refuse_without_weights(arguments.work, figures)
    records = json.loads(arguments.json.read_text()) if arguments.json.exists() else {}
    for figure in figures:
        records[f"figure_{figure}"] = draw[figure](arguments.work, arguments.pictures)
        arguments.json.write_text(json.dumps(records, indent=2) + "\n")


if __name__ == "__main__":
    main()
