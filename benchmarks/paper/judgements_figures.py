"""What the paper says of its Figures 4 and 6, as figures: of all judged frames from the records, and of edges, scale
and features from what `python -m benchmarks.paper.figures` records of the networks of seed 0."""

import json
from collections.abc import Iterable
from functools import cache
from typing import Any

import numpy as np

from benchmarks.paper.intervals import Interval, by_mesh, mean_interval
from benchmarks.paper.judgements import NAMES, PRINTED, Found, means, row
from benchmarks.paper.plan import BODIES, EARLY, RIVALS, SCENES
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


def abnormal_share(records: Records, model: str, scene: str) -> float | None:
    """Share of judged frames whose abs.REL is above `ABNORMAL`, over all seeds."""
    errors = [e for of in records.of(row(model)).values() for e in of["scenes"][scene]["frames"]["abs_rel"]]
    return sum(error > ABNORMAL for error in errors) / len(errors) if errors else None


def abnormal_in_small_intestine(records: Records) -> Found | None:
    """Whether three rivals fail there, and more often than in the colon."""
    shares = {}
    for model in ("std18", "gaenet", "nlspn", PRINTED):
        both = [abnormal_share(records, model, scene) for scene in ("small_intestine", "colon")]
        if None in both:
            return None
        shares[model] = [100 * share for share in both if share is not None]
    text = ", ".join(f"{NAMES[model]} {here:.1f} % ({colon:.1f} %)" for model, (here, colon) in shares.items())
    ours = shares.pop(PRINTED)[0]
    more = all(here > ours for here, _ in shares.values())
    finding = "not reproduced"
    if more and all(here > colon for here, colon in shares.values()):
        finding = "reproduced"
    elif more:
        finding = "they fail more often than ours, but not more often there than in the colon"
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
    return f"steepness at edges in the four scenes, medians over frames: {'; '.join(texts)}", finding


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
    cells = [
        f"{100 * found[PRINTED][s]:.1f} % against {100 * found[rival][s]:.1f} % ({NAMES[rival]})"
        for s, rival in best.items()
    ]
    closer = all(found[PRINTED][scene] < found[rival][scene] for scene, rival in best.items())
    sharper = [
        m for m in RIVALS if all(median_of(m, s, "sharpness") > median_of(PRINTED, s, "sharpness") for s in SCENES)
    ]
    finding = "reproduced" if closer else "not reproduced"
    if closer and sharper:
        finding = f"closer to the truth on all; steeper at edges are {' and '.join(NAMES[m] for m in sharper)}"
    return f"abs.REL of ours against the best rival's of equal computation: {', '.join(cells)}", finding


def shifted_scale_in_csd(_: Records) -> Found | None:
    """Whether a frame's scale is farther off in CSD than on the other scenes."""
    models = (PRINTED, *RIVALS)
    if not has(models):
        return None
    off = {model: [100 * median_of(model, scene, "scale") for scene in SCENES] for model in models}
    text = "; ".join(f"{NAMES[m]} {of[-1]:.1f} % ({', '.join(f'{x:.1f}' for x in of[:-1])})" for m, of in off.items())
    largest = [NAMES[model] for model, of in off.items() if of[-1] > max(of[:-1])]
    finding = f"largest in CSD for {', '.join(largest)} only" if largest else "no larger in CSD than elsewhere"
    if len(largest) == len(models):
        finding = "reproduced"
    return f"a frame's scale is off by, in CSD (on the other scenes): {text}", finding


def richer_by_sa(_: Records) -> Found | None:
    """How much SA adds, in the small intestine and in the colon."""
    change = recorded().get("figure_6", {}).get("sa_change")
    if change is None:
        return None
    added = {s: [100 * of["added"] for of in change[s].values()] for s in ("small_intestine", "colon")}
    texts = [f"{s.replace('_', ' ')} {', '.join(f'{x:.0f} %' for x in of)}" for s, of in added.items()]
    more = all(a > b for a, b in zip(*added.values(), strict=True))
    finding = "reproduced" if more else "not reproduced: it adds less there, and one map to all channels"
    return f"what SA adds, of the features' norm (early fusion, plain U-Net): {'; '.join(texts)}", finding
