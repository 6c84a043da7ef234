"""Rendered frames of the scenes: those to train on, and meshes of other seeds to judge on."""

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.paper.plan import JUDGED_FRAMES, SCENES, SIZE, TRAINING_FRAMES
from completion.data.evaluation_frame import EvaluationFrame
from completion.data.shards import Shard
from haustra.phantom.dataset.shards import ShardPlan, write_shards


def plans(work: Path, scene: str, side: int = SIZE) -> tuple[ShardPlan, ShardPlan]:
    """Frames to train on and to judge on, `side` px square; of another side than usual in folders of that name."""
    training, judged = SCENES[scene]
    name = scene if side == SIZE else f"{scene}_{side}px"
    return (
        ShardPlan(work / name, TRAINING_FRAMES, side, training, scene),
        ShardPlan(work / f"{name}_judged", JUDGED_FRAMES, side, judged, scene),
    )


def render(work: Path, scene: str, side: int = SIZE) -> tuple[Path, Path]:
    """Folders of a scene's frames, rendered now unless they are there; SystemExit if those are of another plan."""
    for plan in plans(work, scene, side):
        about = plan.folder / "shards.json"
        if not about.exists():
            print(f"rendering {plan.frames} frames to {plan.folder}; a stop keeps finished meshes", flush=True)
            write_shards(plan, 2, lambda done, of: print(f"{done} of {of}", flush=True) if done % 100 == 0 else None)
        found = json.loads(about.read_text())
        if any(found[name] != getattr(plan, name) for name in ("frames", "size", "seed", "scene")):
            raise SystemExit(f"error: {plan.folder} has other frames than this table's; give another --work")
    training, judged = plans(work, scene, side)
    return training.folder, judged.folder


def judged_frames(folder: Path, most_mm: float, trained_on: bool = False) -> Iterator[EvaluationFrame]:
    """Every frame, or as many of those that were trained on, named by its mesh; truth beyond `most_mm` is left out, as
    in training."""
    shard = Shard.open(folder)
    training = shard.split()[0]
    for index in (
        training[:: len(training) // JUDGED_FRAMES][:JUDGED_FRAMES] if trained_on else range(len(shard.images))
    ):
        depth = shard.depths[index].astype(np.float32)
        lens = None if shard.lenses is None else shard.lenses[index].astype(float)
        known = np.where(depth < most_mm, depth, 0)
        yield EvaluationFrame(str(shard.colon[index]), np.array(shard.images[index]), known, "mm", lens)
