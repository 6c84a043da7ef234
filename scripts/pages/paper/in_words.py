"""Figures that the page's sentences name, by the name that words.txt has for them."""

import torch

from benchmarks.paper.claims import Reduction, finding
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import PRINTED, percent, rivals_of_all_sizes
from benchmarks.paper.plan import (
    AS_SAVED,
    BODIES,
    PAPER_SIZE,
    PAPER_STEPS,
    READINGS,
    RIVALS,
    TRAINING_FRAMES,
    UNTRAINED,
    Run,
)
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
CHANGED = {
    "cost_metres": "depth in metres",
    "cost_chance": "each pixel by chance, 100 in the mean",
    "cost_constant": "constant rate",
    "cost_thirds": "a tenth of the rate after each third",
    "cost_clipping": "no clipping of gradients",
    "cost_float32": "float32",
    "cost_passes": "every frame once before one comes again",
    "cost_msc_first": "MSC trained first and held fixed",
}
READ = {
    "cost_gamma": "Gamma as printed, beta 1",
    "cost_eq_1": "epsilon 1e-6 in the denominator of Eq. 1",
    "cost_eq_2": "epsilon 1e-6 in the numerator of Eq. 2",
    "cost_sign": "like channels weigh most in SA",
    "cost_levels": "four levels instead of five (0.34 M parameters)",
    "cost_half": "half the channels (0.12 M parameters)",
    "cost_double": "twice the channels (1.93 M parameters)",
    "cost_sparse_first": "sparse depth at the input only",
    "cost_confidence_last": "confidence at the last convolution too",
    "cost_all_scales": "all scales of the pyramid handed on",
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
    return (
        found
        | costs(records)
        | {
            "gain_in_metres": gain(records, "depth in metres", "abs_rel"),
            "gain_of_rmse_in_metres": gain(records, "depth in metres", "rmse"),
            "msc_in_metres": msc_off(records, "depth in metres"),
            "msc_in_our_unit": msc_off(records, AS_SAVED),
            "machines_differ": machines_differ(records),
            "passes": f"{PAPER_STEPS * 10 / trained:.0f}",
            "trained_frames": f"{trained:,}",
            "short_rivals": f"{sum(r['steps_done'] < 2000 for r in theirs)} of {len(theirs)}",
            "same_parameters": f"{min(same):.2f} to {max(same):.2f} M",
            "published": f"{min(growth):.0f} to {max(growth):.0f}",
            "shipped_parameters": f"{shipped / 1e6:.1f} M",
            "missing": f"{100 * most_missing(records):.1f} %",
        }
    )


def higher_by(records: Records, run: Run) -> str:
    """By how much a changed training's abs.REL is above that of the same seeds on the same kind of machine; "" of what
    has no record, or is compared with."""
    beside = Run(("colon",), FULL, change=AS_SAVED if machine(records, run) == "CPU" else "")
    found = None if run == beside else records.reduction("colon", run, beside, "abs_rel")
    if found is None:
        return ""
    return percent(Interval(-found[0].value, -found[0].high, -found[0].low))


def machine(records: Records, run: Run) -> str:
    """On what a run was trained; "" of what has no record."""
    found = records.of(run).values()
    return " ".join(sorted({"GPU" if "gpu" in record["environment"] else "CPU" for record in found}))


def costs(records: Records) -> dict[str, str]:
    """By how much abs.REL is higher with another choice."""
    found = {name: higher_by(records, Run(("colon",), FULL, change=change)) for name, change in CHANGED.items()}
    found |= {name: higher_by(records, Run(("colon",), READINGS[label])) for name, label in READ.items()}
    found["cost_320_px"] = higher_by(records, Run(("colon",), FULL, side=PAPER_SIZE))
    return {name: text or "not measured" for name, text in found.items()}


def gain(records: Records, change: str, figure: str) -> str:
    """By how much a figure of the full network is below its baseline's, both trained with a change."""
    runs = (Run(("colon",), model, change=change) for model in (FULL, BODIES[EARLY][0]))
    found = records.reduction("colon", *runs, figure)
    return percent(found[0]) if found else "(not measured)"


def msc_off(records: Records, change: str) -> str:
    """How far the depth that MSC hands on is off in the mean, after training with a change."""
    mean = records.mean("colon", Run(("colon",), FULL, change=change), "msc_abs_rel")
    return f"{100 * mean.value:.0f} %" if mean else "(not measured)"


def machines_differ(records: Records) -> str:
    """What training the same seeds on another machine changes."""
    again = records.reduction("colon", Run(("colon",), FULL, change=AS_SAVED), Run(("colon",), FULL), "abs_rel")
    if again is None:
        return ""
    higher = f"{-100 * again[0].value:.1f} %"
    return (
        "The last column but one compares with trainings of the same seeds, 0 and 1, on the same kind of machine:\n"
        "on a GPU with the first row's, on a CPU with the second one's, whose abs.REL is\n"
        f"{higher} above that of the same seeds on the GPU. Its intervals have two seeds and are too narrow: the\n"
        "attention of this network is uniform (Figure 6), so that the sign of SA should change little, and yet its\n"
        "interval leaves zero out. A change of a few percent says nothing."
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
