"""Settings of a training run, saved with its weights; the paper's as a preset."""

from __future__ import annotations

from pathlib import Path
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from completion.networks.registry import Size, canonical_name, find_entry
from haustra.core.errors import CompletionError


class TrainConfig(BaseModel):
    """Settings of a training run; they are saved in its checkpoint and its weight file."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    shards: tuple[Path, ...]
    out: Path
    model: str = "mscsa-sfm"  # ours for SfM points, or another name of completion.networks.registry
    size: Size = "paper"  # of the metric networks
    width: int = Field(32, gt=0)  # of mscsa-sfm
    anchor: bool = True  # its last stage
    iterations: int = Field(3, gt=0)  # at most; of mscsa-sfm, see completion.networks.recurrence
    init: Path | None = None  # weights to begin with instead of random ones
    seed: int = Field(0, ge=0)
    steps: int = Field(12000, gt=0)
    batch: int = Field(8, gt=0)
    points: int = Field(100, gt=0)  # per frame, of metric networks; mscsa-sfm is given random numbers of them
    sampler: Literal["uniform", "by_chance", "features"] = "uniform"  # of those points
    mix_shards: bool = True  # a batch has frames of all shards of one size; else of one shard
    passes: bool = False  # every frame of a shard size once before one comes again; else each batch is drawn anew
    msc_first: int = Field(0, ge=0)  # steps in which a metric network's MSC learns alone; then it is held fixed
    optimizer: Literal["adamw", "adam"] = "adamw"
    learning_rate: float = Field(2e-3, gt=0)
    # step: a tenth at `decay_at`; thirds: after each third; plateau: when held-out error stops falling (`plateau`)
    schedule: Literal["cosine", "step", "thirds", "plateau"] = "cosine"
    decay_at: float = Field(1.0, ge=0, le=1)
    warm_up: int = Field(300, ge=0)  # steps of linear growth
    clip: float = Field(1.0, ge=0)  # greatest norm of the gradients; 0: none
    ema: float = Field(0.998, ge=0, lt=1)  # of the weights that are kept; a horizon of 500 steps
    augmentation: bool = True
    bf16: bool = True
    draw_on: Literal["cpu", "device"] = "cpu"  # where random numbers come from; a GPU's own are others than a CPU's
    unit_mm: float = Field(25.0, gt=0)  # metric networks see depth in this unit
    max_depth_mm: float = 250.0  # truth beyond carries no image detail at these resolutions
    device: Literal["auto", "cpu", "cuda"] = "auto"
    checkpoint_seconds: float = 120.0
    threads: int = Field(2, gt=0)


# Section III-B: Adam, 1e-3, L1, batch 10, no augmentation named. "A decaying factor of 10" is read as a tenth of the
# rate after ten epochs, which is when the paper's training ends: constant.
PAPER: dict[str, Any] = {
    "optimizer": "adam",
    "learning_rate": 1e-3,
    "schedule": "step",
    "warm_up": 0,
    "batch": 10,
    "points": 100,
    "augmentation": False,
    "ema": 0.0,
}
RENAMED = {"looks": "iterations"}  # of checkpoints that earlier releases wrote


def with_new_names(settings: dict[str, Any]) -> dict[str, Any]:
    """Settings as a checkpoint has them, in today's names of settings and networks."""
    renamed = {RENAMED.get(name, name): value for name, value in settings.items()}
    return renamed | {"model": canonical_name(renamed["model"])}


def make_config(preset: str | None = None, **values: Any) -> TrainConfig:
    """A preset ("paper" or None), overridden by values; CompletionError names the first invalid setting."""
    if preset not in (None, "paper"):
        raise CompletionError(f"no preset {preset!r}; there is 'paper'")
    if "size" in values and not find_entry(values.get("model", "mscsa-sfm")).is_metric:
        raise CompletionError("--size is of the networks of the paper's comparison: give --model too")
    try:
        return TrainConfig(**((PAPER if preset else {}) | values))
    except ValidationError as error:
        first = error.errors()[0]
        raise CompletionError(f"training setting {'.'.join(map(str, first['loc']))}: {first['msg']}") from None
