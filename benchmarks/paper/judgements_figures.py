"""What the paper says of its Figures 4 to 6, as figures: of all judged frames from the records, and of edges, scale
and features from what `python -m benchmarks.paper.figures` records of the networks of seed 0."""

import json
import math
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from benchmarks.paper.intervals import Interval, Table, apart_interval, by_mesh, mean_interval
from benchmarks.paper.judgements import NAMES, PRINTED, Found, Judge, in_digits, means, percent, row
from benchmarks.paper.plan import BODIES, EARLY, FIGURE_5, POINT_COUNTS, RIVALS, SCENES, Run
from benchmarks.paper.records import FIGURES, Records

ABNORMAL = 0.2  # abs.REL of a frame
Frames = dict[str, list[float]]  # of `figure_4.figures_of`


@cache
def recorded() -> dict[str, Any]:
    """What was drawn; {} where nothing was."""
    return dict(json.loads(FIGURES.read_text())) if FIGURES.exists() else {}


def measured() -> dict[str, dict[str, Frames]]:
    """Network, scene, figures of every eighth judged frame."""
    return dict(recorded().get("figure_4", {}).get("measured", {}))


def has(models: Iterable[str]) -> bool:
    """Whether all of these were measured."""
    return all(model in measured() for model in models)


def median_of(model: str, scene: str, figure: str) -> float:
    """Median over frames; of the scale, of the size of its logarithm."""
    values = np.array(measured()[model][scene][figure])
    return float(np.median(np.abs(np.log(values)) if figure == "scale" else values))


def abnormal_shares(records: Records, model: str, scene: str, seeds: set[int]) -> Table:
    """(S,M) share of a mesh's frames whose abs.REL is above `ABNORMAL`."""
    frames = [of["scenes"][scene]["frames"] for seed, of in records.of(row(model)).items() if seed in seeds]
    return np.array([by_mesh([error > ABNORMAL for error in of["abs_rel"]], of["mesh"]) for of in frames])


def abnormal_in_small_intestine(records: Records) -> Found | None:
    """How many of three rivals fail there more often than ours, and more often than in the colon."""
    models = ("std18", "gaenet", "nlspn", PRINTED)
    seeds = set.intersection(*(set(records.of(row(model))) for model in models))
    if not seeds:
        return None
    shares = {m: [abnormal_shares(records, m, s, seeds) for s in ("small_intestine", "colon")] for m in models}
    text = ", ".join(f"{NAMES[m]} {100 * s.mean():.1f} % ({100 * c.mean():.1f} %)" for m, (s, c) in shares.items())
    ours = shares.pop(PRINTED)[0]
    more = sum(mean_interval(there - ours).low > 0 for there, _ in shares.values())
    than_colon = sum(apart_interval(there, colon).low > 0 for there, colon in shares.values())
    finding = f"beyond the interval {more} of 3 fail more often than ours, and {than_colon} than in the colon"
    if more == than_colon == len(shares):
        finding = "reproduced"
    return f"frames with abs.REL above {100 * ABNORMAL:.0f} %: small intestine (colon) {text}", finding


def edges_blurred(rivals: tuple[str, ...]) -> Found | None:
    """Sharpness of rivals' edges beside ours, by frame and scene; the intervals draw meshes."""
    if not has((*rivals, PRINTED)):
        return None
    blunter: dict[str, int] = {}  # scenes in which ours are steeper beyond the interval
    steeper: dict[str, int] = {}
    for model in rivals:
        intervals = [interval_of_edges(model, scene) for scene in SCENES]
        blunter[model], steeper[model] = sum(of.low > 0 for of in intervals), sum(of.high < 0 for of in intervals)
    shown = (*rivals, PRINTED, *(model for model in BODIES[EARLY] if has((model,))))
    edges = {m: ", ".join(f"{median_of(m, scene, 'sharpness'):.2f}" for scene in SCENES) for m in shown}
    texts = (f"{NAMES[model]} {values}" for model, values in edges.items())
    if all(count == len(SCENES) for count in blunter.values()):
        finding = "reproduced"
    elif all(count == len(SCENES) for count in steeper.values()):
        finding = "not reproduced, theirs are steeper"
    else:
        counts = (f"{NAMES[model]} in {count} of {len(SCENES)} scenes" for model, count in blunter.items())
        finding = f"more blurred than ours beyond the interval: {', '.join(counts)}"
    return f"steepness at edges in the four scenes, medians over frames: {'; '.join(texts)}", f"{finding}, 1 seed"


def interval_of_edges(rival: str, scene: str) -> Interval:
    """By how much our edges are steeper than a rival's, mean over meshes."""
    theirs, ours = (sharpness_of_meshes(of, scene) for of in (rival, PRINTED))
    shared = sorted(theirs.keys() & ours.keys())
    return mean_interval(np.array([[ours[mesh] - theirs[mesh] for mesh in shared]]))


def sharpness_of_meshes(model: str, scene: str) -> dict[int, float]:
    """Mean over each mesh's frames."""
    of = measured()[model][scene]
    meshes = [int(mesh) for mesh in of["mesh"]]
    return dict(zip(sorted(set(meshes)), by_mesh(of["sharpness"], meshes).tolist(), strict=True))


def blurred_by_std(_: Records) -> Found | None:
    """StD's edges beside ours."""
    return edges_blurred(("std18", "std50"))


def rough_by_nlspn(_: Records) -> Found | None:
    """NLSPN's edges beside ours."""
    return edges_blurred(("nlspn",))


def closest_everywhere(records: Records) -> Found | None:
    """abs.REL of ours beside the best rival, scene by scene, and whose edges are the sharpest."""
    found = means(records, "abs_rel", (PRINTED, *RIVALS))
    if found is None or not has((PRINTED, *RIVALS)):
        return None
    best = {scene: min(RIVALS, key=lambda model: found[model][scene]) for scene in SCENES}
    below = {scene: records.reduction(scene, row(PRINTED), row(rival), "abs_rel") for scene, rival in best.items()}
    cells = [f"{percent(of[0])} below {NAMES[best[scene]]}" for scene, of in below.items() if of]
    closer = all(of is not None and of[0].low > 0 for of in below.values())
    sharper = [
        m for m in RIVALS if all(median_of(m, s, "sharpness") > median_of(PRINTED, s, "sharpness") for s in SCENES)
    ]
    finding = "reproduced" if closer else "not reproduced"
    if closer and sharper:
        finding = f"closer to the truth on all; steeper at edges are {' and '.join(NAMES[m] for m in sharper)}"
    return f"abs.REL of ours beside the best rival's of equal computation, by scene: {', '.join(cells)}", finding


def shifted_scale_in_csd(_: Records) -> Found | None:
    """Whether a frame's scale is farther off in CSD than on the other scenes."""
    models = (PRINTED, *RIVALS)
    if not has(models):
        return None
    off = {model: [100 * median_of(model, scene, "scale") for scene in SCENES] for model in models}
    text = "; ".join(f"{NAMES[m]} {of[-1]:.1f} % ({', '.join(f'{x:.1f}' for x in of[:-1])})" for m, of in off.items())
    largest = [NAMES[model] for model in models if scale_off_in_csd(model).low > 0]
    finding = f"beyond the interval larger in CSD for {', '.join(largest) or 'none'}"
    if len(largest) == len(models):
        finding = "reproduced"
    return f"a frame's scale is off by, in CSD (on the other scenes): {text}", f"{finding}, 1 seed"


def scale_off_in_csd(model: str) -> Interval:
    """By how much frames' scales are farther off in CSD than on the worst other scene, mean over meshes."""
    tables = {}
    for scene in SCENES:
        of = measured()[model][scene]
        tables[scene] = by_mesh([abs(math.log(scale)) for scale in of["scale"]], [int(m) for m in of["mesh"]])[None]
    worst = max((scene for scene in SCENES if scene != "csd"), key=lambda scene: float(tables[scene].mean()))
    return apart_interval(tables["csd"], tables[worst])


def where_sa_adds(_: Records) -> Found:
    """Cannot be seen at this size."""
    return "", "not measured: 5x5 positions cannot show edges of 160 px; what SA adds is one map to all channels"


def richer_by_sa(_: Records) -> Found | None:
    """How much SA adds, in the small intestine and in the colon."""
    change = recorded().get("figure_6", {}).get("sa_change")
    if change is None:
        return None
    added = {s: [100 * of["added"] for of in change[s].values()] for s in ("small_intestine", "colon")}
    texts = [f"{s.replace('_', ' ')} {', '.join(f'{x:.0f} %' for x in of)}" for s, of in added.items()]
    more = all(a > b for a, b in zip(*added.values(), strict=True))
    finding = "reproduced" if more else "not reproduced: it adds less there, and one map to all channels"
    return f"what SA adds, of the features' norm (early fusion, plain U-Net): {'; '.join(texts)}", f"{finding}, 1 seed"


def points(count: int, sampler: str) -> Run:
    """A run of Figure 5."""
    return Run(("colon",), FIGURE_5, points=count, sampler=sampler)


def rises(records: Records, few: int, many: int) -> tuple[dict[str, float], Interval] | None:
    """By how much delta 1 rises between two numbers of points, by sampler; and the rise with uniform points less that
    with features, of the seeds that all have."""
    runs = {sampler: (points(few, sampler), points(many, sampler)) for sampler in ("uniform", "features")}
    shared = set.intersection(*(set(records.of(run)) for both in runs.values() for run in both))
    if not shared:
        return None
    tables = {s: [records.table("colon", run, "delta_1", shared) for run in both] for s, both in runs.items()}
    risen = {sampler: after - before for sampler, (before, after) in tables.items()}
    return {s: float(of.mean()) for s, of in risen.items()}, mean_interval(risen["uniform"] - risen["features"])


def steeper_for_uniform(records: Records) -> Found | None:
    """delta 1 from the fewest to the most points."""
    found = rises(records, POINT_COUNTS[0], POINT_COUNTS[-1])
    if found is None:
        return None
    texts, rising = [], True
    for sampler in ("uniform", "features"):
        known = [records.mean("colon", points(count, sampler), "delta_1") for count in POINT_COUNTS]
        values = [one.value for one in known if one]
        texts.append(f"{sampler} {', '.join(f'{value:.4f}' for value in values)}")
        rising &= len(values) == len(POINT_COUNTS) and values == sorted(values)
    more = found[1]
    finding = "reproduced" if rising and more.low > 0 else "it does not rise throughout"
    if rising and more.low <= 0:
        finding = "it rises, but for features more" if more.high < 0 else "it rises; for which more is not decided"
    counts = ", ".join(f"{count:,}" for count in POINT_COUNTS)
    return f"delta 1 at {counts} points: {'; '.join(texts)}; rise, uniform less features: {in_digits(more)}", finding


def growth_with_features(records: Records) -> Found | None:
    """Whether delta 1 rises less with feature points than with uniform ones, from 10 to 1,000."""
    found = rises(records, 10, 1000)
    if found is None:
        return None
    rise, more = found
    text = ", ".join(f"{sampler} {value:.4f}" for sampler, value in rise.items())
    return f"delta 1 rises from 10 to 1,000 points by: {text}; uniform less features {in_digits(more)}", more.finding


def features_higher(records: Records, count: int) -> Interval | None:
    """By how much abs.REL of feature points is above that of uniform ones, as a fraction."""
    found = records.reduction("colon", points(count, "features"), points(count, "uniform"), "abs_rel")
    return None if found is None else -found[0]


def gain_of_features(counts: tuple[int, ...]) -> Judge:
    """Whether feature points gain over uniform ones at these numbers."""

    def judge(records: Records) -> Found | None:
        found = {count: higher for count in counts if (higher := features_higher(records, count))}
        if len(found) < len(counts):
            return None
        finding = "they gain"
        if all(higher.low > 0 for higher in found.values()):
            finding = "they lose"
        elif all(higher.high >= 0 for higher in found.values()):
            finding = "they gain nothing"
        return _instead(found), finding

    return judge


def many_features(records: Records) -> Found | None:
    """At the most points there are not enough keypoints to tell."""
    most = max(POINT_COUNTS)
    higher = features_higher(records, most)
    if higher is None:
        return None
    return _instead({most: higher}), "cannot be tested at 160 px: nearly all of these points are uniform ones"


def _instead(found: dict[int, Interval]) -> str:
    cells = (f"{count:,} points: {percent(higher)} higher" for count, higher in found.items())
    return "abs.REL with features instead of uniform points: " + "; ".join(cells)
