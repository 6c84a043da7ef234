"""Figures that the page's sentences name, by the name that words.txt has for them."""

from collections.abc import Callable

import numpy as np
import torch

from benchmarks.paper.batch_statistics import EVERY
from benchmarks.paper.claims import Reduction, finding
from benchmarks.paper.judgements import PRINTED, named_rivals, percent, row
from benchmarks.paper.plan import (
    AS_ITS_SOURCE,
    AS_SAVED,
    AT_LENGTH,
    BODIES,
    CONSTANT,
    EARLY,
    FLOAT32,
    IN_METRES,
    METRES,
    NORMALISATIONS,
    PAPER_SIZE,
    PAPER_STEPS,
    READINGS,
    RIVALS,
    SCENES,
    SIZE,
    TRAINED_ON,
    TRAINING_FRAMES,
    UNTRAINED,
    Run,
    Training,
)
from benchmarks.paper.published import FIGURE_NAMES, TABLE_2
from benchmarks.paper.records import AGAIN, LATER, Records, row_of_record, row_of_run
from completion.data.shards import validation_meshes
from completion.networks.checkpoint import load_network
from completion.networks.registry import Size, build_model
from completion.weights.shipped_weights import resolve_weights
from haustra.core.text import counted
from haustra.phantom.dataset.shards import FRAMES_PER_COLON

FULL = "mscsa-early-fusion"  # on which choices of training were changed one at a time
OURS_AT_LENGTH, PLAIN_AT_LENGTH, BATCH_AT_LENGTH = AT_LENGTH
METRES_AT_LENGTH, CONSTANT_AT_LENGTH = (Training(EARLY, PAPER_STEPS, change) for change in (METRES, CONSTANT))
# name: row, row beside, figure, training; in the colon
REDUCTIONS = {
    "full_at_length": ("full", "baseline", "abs_rel", OURS_AT_LENGTH),
    "plain_at_length": ("full", "baseline", "abs_rel", PLAIN_AT_LENGTH),
    "batch_at_length": ("full", "baseline", "abs_rel", BATCH_AT_LENGTH),
    "full_rmse_at_length": ("full", "baseline", "rmse", OURS_AT_LENGTH),
    **{f"msc_rmse_{n}": ("+MSC", "baseline", "rmse", Training(body)) for n, body in enumerate(BODIES)},
    "msc_rmse_at_length": ("+MSC", "baseline", "rmse", OURS_AT_LENGTH),
    "rmse_metres": ("full", "baseline", "rmse", METRES_AT_LENGTH),
    "rmse_constant": ("full", "baseline", "rmse", CONSTANT_AT_LENGTH),
    "sa_metres": ("full", "+MSC", "abs_rel", METRES_AT_LENGTH),
    "sa_alone_source": ("+SA", "baseline", "abs_rel", AS_ITS_SOURCE),
    "full_as_source": ("full", "baseline", "abs_rel", AS_ITS_SOURCE),
    "full_rmse_as_source": ("full", "baseline", "rmse", AS_ITS_SOURCE),
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


def figures(records: Records) -> dict[str, str]:
    """By name."""
    found: dict[str, str] = {}
    for name, of in REDUCTIONS.items():
        found[name], found[f"{name}_seeds"] = reduced(records, *of)
    rivals = {row_of_run(run) for run in named_rivals().values()}
    theirs = [record for record in records.records if row_of_record(record) in rivals]
    same = [record["parameters"] / 1e6 for record in theirs if record["size"] == "same-parameters"]
    watched = validation_meshes(TRAINING_FRAMES // FRAMES_PER_COLON) * FRAMES_PER_COLON
    trained = TRAINING_FRAMES - watched
    growth = [size_of(model, "paper") / size_of(model, "small") for model in (PRINTED, *RIVALS)]
    published = TABLE_2["colon"]["full"]
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
            "baseline_as_source": abs_rel_of(records, AS_ITS_SOURCE.runs("colon")["baseline"]),
            "linear": abs_rel_of(records, Run(("colon",), "linear")),
            "published_baseline": f"{TABLE_2['colon']['baseline']['abs_rel']:.1f} %",
            "paper_depth": f"{100 * published['mae'] / published['abs_rel']:.0f} cm",
            "our_depth": mean_depth(records),
            "same_frames": f"{100 * judged_of_the_batches(records):.1f} % in the mean",
            "nlspn_rmse": scenes_below_linear(lambda *of: mean_of(records, *of, "rmse")),
            "nlspn_median": scenes_below_linear(lambda *of: records.median_frame(*of, "abs_rel")),
            "nlspn_larger": scenes_below_linear(lambda *of: mean_of(records, *of, "abs_rel"), "same-parameters"),
            "beyond": f"{100 * share_beyond(records):.1f} %",
            "cost_trained_on": f"{abs_rel_of(records, Run(('colon',), FULL, change=TRAINED_ON), 2)} instead of "
            f"{abs_rel_of(records, Run(('colon',), FULL, change=AS_SAVED), 2)}",
            "cost_judged_float32": higher_by(records, Run(("colon",), FULL, change=FLOAT32)),
            "on_another_machine": on_another_machine(records),
            "trained_again": trained_again(records, Records.read(AGAIN)),
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
    """By how much a changed training's abs.REL is above that of the same seeds on the same kind of machine, with the
    number of seeds unless it is two; "" of what has no record, or is compared with."""
    beside = Run(("colon",), FULL, steps=run.steps, change=AS_SAVED if machine(records, run) == "CPU" else "")
    found = None if run == beside else records.reduction("colon", run, beside, "abs_rel")
    if found is None:
        return ""
    text = percent(-found[0])
    return text if found[1] == 2 else f"{text} ({seeds_in_words(found[1])})"


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
    """What the mean over all pixels, instead of over frames' figures, changes."""
    rows = IN_METRES.runs("colon")
    seeds = seeds_with_pixels(records, rows["full"]) & seeds_with_pixels(records, rows["baseline"])
    if not seeds:
        return "not measured"
    full, baseline = (pooled_errors(records, rows[name], seeds) for name in ("full", "baseline"))
    below = [f"{100 * (1 - ours / theirs):.1f} %" for ours, theirs in zip(full, baseline, strict=True)]
    return (
        f"over all pixels, in metres, {counted(len(seeds), 'seed')}: full below its baseline by abs.REL {below[1]} "
        f"instead of {below[0]}, RMSE {below[3]} instead of {below[2]}"
    )


def seeds_with_pixels(records: Records, run: Run) -> set[int]:
    """Seeds of a row whose records have the number of judged pixels; older ones have not."""
    return {seed for seed, of in records.of(run).items() if "pixels" in of["scenes"]["colon"]["frames"]}


def pooled_errors(records: Records, run: Run, seeds: set[int]) -> tuple[float, float, float, float]:
    """abs.REL as the mean over frames and over pixels, and RMSE likewise, of some seeds."""
    frames = [of["scenes"]["colon"]["frames"] for seed, of in records.of(run).items() if seed in seeds]
    pixels, abs_rel, rmse = (np.concatenate([of[name] for of in frames]) for name in ("pixels", "abs_rel", "rmse"))
    over_pixels = np.average(abs_rel, weights=pixels), np.sqrt(np.average(rmse**2, weights=pixels))
    return float(abs_rel.mean()), float(over_pixels[0]), float(rmse.mean()), float(over_pixels[1])


def abs_rel_of(records: Records, run: Run, digits: int = 1) -> str:
    """Mean over frames and seeds, in the colon."""
    mean = records.mean("colon", run, "abs_rel")
    return f"{100 * mean.value:.{digits}f} %" if mean else "(not measured)"


def mean_depth(records: Records) -> str:
    """About how far the wall of the judged frames is: MAE over abs.REL of the nearest point."""
    mae, abs_rel = (records.mean("colon", Run(("colon",), "nearest"), figure) for figure in ("mae", "abs_rel"))
    return f"{mae.value / abs_rel.value / 10:.1f} cm" if mae and abs_rel else "(not measured)"


def trained_again(records: Records, again: Records) -> str:
    """By how much the figures of trainings that were made on another machine as well differ, by figure."""
    cells = []
    for figure in ("abs_rel", "rmse"):
        ratios = []
        for record in again.records:
            run = next(r for r in IN_METRES.runs("colon").values() if r.model == record["model"])
            pair = [of.table("colon", run, figure, {record["seed"]}).mean() for of in (again, records)]
            ratios.append(100 * (pair[1] / pair[0] - 1))
        cells.append(f"{FIGURE_NAMES[figure]} is higher by {min(ratios):.0f} to {max(ratios):.0f} %")
    return f"{len(again.records)} trainings were made on a CPU, too; on the GPU {' and '.join(cells)}"


def on_another_machine(records: Records) -> str:
    """By how much abs.REL is higher where the same seeds were trained on a CPU."""
    again = records.reduction("colon", Run(("colon",), FULL, change=AS_SAVED), Run(("colon",), FULL), "abs_rel")
    return f"{-100 * again[0].value:.1f} %" if again else "(not measured)"


def reduced(records: Records, name: str, beside: str, figure: str, training: Training) -> tuple[str, str]:
    """A reduction in the colon with its interval, and of how many seeds it is."""
    found = finding(records, Reduction("colon", name, beside, figure), training)
    return (percent(found[0]), seeds_in_words(found[1])) if found else ("(not measured)", seeds_in_words(0))


def seeds_in_words(count: int) -> str:
    """At most three."""
    return f"{('no', 'one', 'two', 'three')[count]} seed{'s' * (count != 1)}"


def judged_of_the_batches(records: Records) -> float:
    """abs.REL of the network with batch normalisation, as judged, of the frames that it was given in training mode."""
    found = records.of(Run(("colon",), NORMALISATIONS["batch"])).values()
    return float(np.mean([of["scenes"]["colon"]["frames"]["abs_rel"][::EVERY] for of in found]))


def mean_of(records: Records, scene: str, run: Run, figure: str) -> float | None:
    """A row's mean; None without a record."""
    found = records.mean(scene, run, figure)
    return found.value if found else None


def scenes_below_linear(of: Callable[[str, Run], float | None], size: Size = "small") -> str:
    """In how many scenes NLSPN has less of a figure than linear interpolation."""
    both = [(of(scene, row("nlspn", size)), of(scene, Run(tuple(SCENES), "linear"))) for scene in SCENES]
    return str(sum(theirs is not None and floor is not None and theirs < floor for theirs, floor in both))


def share_beyond(records: Records) -> float:
    """Share of the pixels of the colon's judged frames that have no true depth to be judged by."""
    frames = next(
        frames
        for record in records.records
        if "colon" in record["scenes"] and "pixels" in (frames := record["scenes"]["colon"]["frames"])
    )
    judged = sum(frames["pixels"]) + sum(frames["missing"])
    return 1 - judged / (len(frames["pixels"]) * SIZE**2)


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
