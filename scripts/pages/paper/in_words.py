"""Figures that the page's sentences name, by the name that words.txt has for them."""

import torch

from benchmarks.paper.claims import Reduction, finding
from benchmarks.paper.judgements import PRINTED, percent, rivals_of_all_sizes
from benchmarks.paper.plan import AS_SAVED, PAPER_STEPS, RIVALS, TRAINING_FRAMES, UNTRAINED, Run
from benchmarks.paper.records import LATER, Records
from completion.networks.checkpoint import load_network
from completion.networks.registry import Size, build_model
from completion.weights.shipped_weights import resolve_weights

FULL = "mscsa-early-fusion"  # on which choices of training were changed one at a time
EARLY, PLAIN, BATCH = "early fusion", "U-Net, plain", "U-Net, batch normalisation"
# name: scene, row, row beside, figure, body, steps
REDUCTIONS = {
    "full_at_length": ("colon", "full", "baseline", "abs_rel", EARLY, PAPER_STEPS),
    "plain_at_length": ("colon", "full", "baseline", "abs_rel", PLAIN, PAPER_STEPS),
    "batch_at_length": ("colon", "full", "baseline", "abs_rel", BATCH, PAPER_STEPS),
    "full_rmse_at_length": ("colon", "full", "baseline", "rmse", EARLY, PAPER_STEPS),
}
HELD_OUT = 0.05  # of the meshes to train on: watched, not trained on (`Shard.split`)


def figures(records: Records) -> dict[str, str]:
    """By name."""
    found = {name: reduced(records, *of) for name, of in REDUCTIONS.items()}
    theirs = [record for run in rivals_of_all_sizes() for record in records.of(run).values()]
    same = [record["parameters"] / 1e6 for record in theirs if record["size"] == "same-parameters"]
    trained = TRAINING_FRAMES - round(HELD_OUT * TRAINING_FRAMES / 20) * 20
    growth = [size_of(model, "paper") / size_of(model, "small") for model in (PRINTED, *RIVALS)]
    shipped = sum(p.numel() for p in load_network(resolve_weights("mscsa")).parameters())
    return found | {
        "machines_differ": machines_differ(records),
        "passes": f"{PAPER_STEPS * 10 / trained:.0f}",
        "trained_frames": f"{trained:,}",
        "short_rivals": f"{sum(r['steps_done'] < 2000 for r in theirs)} of {len(theirs)}",
        "same_parameters": f"{min(same):.2f} to {max(same):.2f} M",
        "published": f"{min(growth):.0f} to {max(growth):.0f}",
        "shipped_parameters": f"{shipped / 1e6:.1f} M",
        "missing": f"{100 * most_missing(records):.1f} %",
    }


def machines_differ(records: Records) -> str:
    """What training the same seeds on another machine changes."""
    again = records.reduction("colon", Run(("colon",), FULL, change=AS_SAVED), Run(("colon",), FULL), "abs_rel")
    if again is None:
        return ""
    higher = f"{-100 * again[0].value:.1f} %"
    return (
        "The last column compares with trainings of the same seeds on the same kind of machine. For changes that were\n"
        f"trained on a CPU two seeds were trained again there: their abs.REL is {higher} above that of the same\n"
        "seeds on the GPU. A change of a few percent says nothing."
    )


def reduced(records: Records, scene: str, name: str, beside: str, figure: str, body: str, steps: int) -> str:
    """A reduction with its interval."""
    found = finding(records, Reduction(scene, name, beside, figure), body, steps)
    return percent(found[0]) if found else "(not measured)"


def size_of(model: str, size: Size) -> int:
    """Parameters of a network."""
    with torch.device("meta"):
        return sum(p.numel() for p in build_model(model, size).parameters())


def most_missing(records: Records) -> float:
    """Largest share of a scene's judged pixels that a training left out, since it said no positive depth there."""
    shares = [
        sum(of["frames"]["missing"]) / len(of["frames"]["missing"]) / (LATER | record)["side"] ** 2
        for record in records.records
        if record["model"] not in UNTRAINED
        for of in record["scenes"].values()
    ]
    return max(shares, default=0.0)
