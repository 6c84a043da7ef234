"""Figures that the page's sentences name, by the name that words.txt has for them."""

import numpy as np
import torch

from benchmarks.paper.claims import Reduction, finding
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import PRINTED, percent, rivals_of_all_sizes
from benchmarks.paper.plan import (
    AS_ITS_SOURCE,
    AS_SAVED,
    AT_LENGTH,
    CONSTANT,
    EARLY,
    IN_METRES,
    METRES,
    PAPER_SIZE,
    PAPER_STEPS,
    READINGS,
    RIVALS,
    TRAINING_FRAMES,
    UNTRAINED,
    Run,
    Training,
)
from benchmarks.paper.records import LATER, Records
from completion.networks.checkpoint import load_network
from completion.networks.registry import Size, build_model
from completion.weights.shipped_weights import resolve_weights

FULL = "mscsa-early-fusion"  # on which choices of training were changed one at a time
OURS_AT_LENGTH, PLAIN_AT_LENGTH, BATCH_AT_LENGTH = AT_LENGTH
METRES_AT_LENGTH, CONSTANT_AT_LENGTH = (Training(EARLY, PAPER_STEPS, change) for change in (METRES, CONSTANT))
# name: row, row beside, figure, training; in the colon
REDUCTIONS = {
    "full_at_length": ("full", "baseline", "abs_rel", OURS_AT_LENGTH),
    "plain_at_length": ("full", "baseline", "abs_rel", PLAIN_AT_LENGTH),
    "batch_at_length": ("full", "baseline", "abs_rel", BATCH_AT_LENGTH),
    "full_rmse_at_length": ("full", "baseline", "rmse", OURS_AT_LENGTH),
    "full_in_metres": ("full", "baseline", "abs_rel", IN_METRES),
    "full_rmse_in_metres": ("full", "baseline", "rmse", IN_METRES),
    "full_as_source": ("full", "baseline", "abs_rel", AS_ITS_SOURCE),
    "full_rmse_as_source": ("full", "baseline", "rmse", AS_ITS_SOURCE),
    "full_rmse_metres_at_length": ("full", "baseline", "rmse", METRES_AT_LENGTH),
    "full_rmse_constant_at_length": ("full", "baseline", "rmse", CONSTANT_AT_LENGTH),
}
CHANGED = {
    "cost_metres": METRES,
    "cost_chance": "each pixel by chance, 100 in the mean",
    "cost_constant": CONSTANT,
    "cost_thirds": "a tenth of the rate after each third",
    "cost_clipping": "no clipping of gradients",
    "cost_float32": "float32",
    "cost_passes": "every frame once before one comes again",
    "cost_msc_first": "MSC trained first and held fixed",
}
READ = {
    "cost_replaced": "weights replaced by Gamma in each step",
    "cost_gain": "a learnt weight of SA, from zero",
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
    found |= {f"{name}_seeds": seeds(records, *of) for name, of in REDUCTIONS.items()}
    theirs = [record for run in rivals_of_all_sizes() for record in records.of(run).values()]
    same = [record["parameters"] / 1e6 for record in theirs if record["size"] == "same-parameters"]
    trained = TRAINING_FRAMES - round(HELD_OUT * TRAINING_FRAMES / 20) * 20
    growth = [size_of(model, "paper") / size_of(model, "small") for model in (PRINTED, *RIVALS)]
    shipped = sum(p.numel() for p in load_network(resolve_weights("mscsa")).parameters())
    return (
        found
        | costs(records)
        | {
            "msc_in_metres": msc_off(records, Run(("colon",), FULL, change=METRES)),
            "msc_in_our_unit": msc_off(records, Run(("colon",), FULL)),
            "msc_in_metres_at_length": msc_off(records, METRES_AT_LENGTH.runs("colon")["full"]),
            "msc_in_our_unit_at_length": msc_off(records, OURS_AT_LENGTH.runs("colon")["full"]),
            "pooled": pooled(records),
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
    beside = Run(("colon",), FULL, steps=run.steps, change=AS_SAVED if machine(records, run) == "CPU" else "")
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
    for change, name in ((METRES, "cost_metres_at_length"), (CONSTANT, "cost_constant_at_length")):
        found[name] = higher_by(records, Run(("colon",), FULL, steps=PAPER_STEPS, change=change))
    return {name: text or "not measured" for name, text in found.items()}


def msc_off(records: Records, run: Run) -> str:
    """How far the depth that MSC hands on is off in the mean."""
    mean = records.mean("colon", run, "msc_abs_rel")
    return f"{100 * mean.value:.0f} %" if mean else "(not measured)"


def pooled(records: Records) -> str:
    """What the mean over all pixels, instead of over frames' figures, changes; of rows that record their pixels."""
    rows = OURS_AT_LENGTH.runs("colon")
    both = [pooled_errors(records, rows[name]) for name in ("full", "baseline")]
    if None in both:
        return "not measured"
    full, baseline = both
    cells = (f"{title} {100 * (1 - full[i] / baseline[i]):.1f} %" for i, title in ((1, "abs.REL"), (3, "RMSE")))
    given = (f"{100 * (1 - full[i] / baseline[i]):.1f} %" for i in (0, 2))
    higher = f"RMSE of the full network {100 * (full[3] / full[2] - 1):.0f} % higher"
    reductions = " and ".join(f"{cell} instead of {of}" for cell, of in zip(cells, given, strict=True))
    return f"over all pixels, at {PAPER_STEPS:,} steps: {higher}; full below its baseline by {reductions}"


def pooled_errors(records: Records, run: Run) -> tuple[float, float, float, float] | None:
    """abs.REL as the mean over frames and over pixels, RMSE likewise, of the seeds whose pixels are recorded."""
    found = [r["scenes"]["colon"]["frames"] for r in records.of(run).values()]
    frames = [of for of in found if "pixels" in of]
    if not frames:
        return None
    pixels, abs_rel, rmse = (np.concatenate([of[name] for of in frames]) for name in ("pixels", "abs_rel", "rmse"))
    over_pixels = np.average(abs_rel, weights=pixels), np.sqrt(np.average(rmse**2, weights=pixels))
    return float(abs_rel.mean()), float(over_pixels[0]), float(rmse.mean()), float(over_pixels[1])


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


def reduced(records: Records, name: str, beside: str, figure: str, training: Training) -> str:
    """A reduction in the colon, with its interval."""
    found = finding(records, Reduction("colon", name, beside, figure), training)
    return percent(found[0]) if found else "(not measured)"


def seeds(records: Records, name: str, beside: str, figure: str, training: Training) -> str:
    """Of how many seeds a reduction is."""
    found = finding(records, Reduction("colon", name, beside, figure), training)
    count = found[1] if found else 0
    return f"{('no', 'one', 'two', 'three')[count]} seed{'s' * (count != 1)}"


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
