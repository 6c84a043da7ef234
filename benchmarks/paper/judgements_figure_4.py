"""What the paper says of its Figure 4, as figures: of all judged frames from the records, and of depth edges and scale
from `figure_4.figures_of`, which `python -m benchmarks.paper.figures` records."""

import json
from collections.abc import Iterable
from functools import cache

from benchmarks.paper.judgements import NAMES, PRINTED, Found, means, row
from benchmarks.paper.plan import OURS, RIVALS, SCENES
from benchmarks.paper.records import FIGURES, Records

ABNORMAL = 0.2  # abs.REL of a frame


@cache
def measured() -> dict[str, dict[str, dict[str, float]]]:
    """Network, scene, figure of every eighth judged frame; {} where the figure was not drawn."""
    return dict(json.loads(FIGURES.read_text()).get("figure_4", {}).get("measured", {})) if FIGURES.exists() else {}


def has(models: Iterable[str]) -> bool:
    """Whether all of these were measured."""
    return all(model in measured() for model in models)


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
    """Sharpness of depth edges by rivals and ours, scene by scene."""
    if not has((*rivals, PRINTED)):
        return None
    ours = [measured()[PRINTED][scene]["sharpness"] for scene in SCENES]
    theirs = {model: [measured()[model][scene]["sharpness"] for scene in SCENES] for model in rivals}
    text = "; ".join(f"{NAMES[m]} {', '.join(f'{x:.2f}' for x in of)}" for m, of in (theirs | {PRINTED: ours}).items())
    less = all(x < y for of in theirs.values() for x, y in zip(of, ours, strict=True))
    return f"sharpness of edges in the four scenes: {text}", "reproduced" if less else "not reproduced"


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
        m for m in RIVALS if any(measured()[m][s]["sharpness"] > measured()[PRINTED][s]["sharpness"] for s in SCENES)
    ]
    finding = "reproduced" if closer else "not reproduced"
    if closer and sharper:
        finding = f"closer on all, but {', '.join(NAMES[m] for m in sharper)} has sharper edges"
    return f"abs.REL of ours against the best rival's: {', '.join(cells)}", finding


def shifted_scale_in_csd(_: Records) -> Found | None:
    """Whether the median ratio of completed to true depth is farthest from one in CSD, for all networks."""
    models = [model for model in (*OURS, *RIVALS) if model in measured()]
    if not has((PRINTED, *RIVALS)):
        return None
    off = {model: {scene: abs(measured()[model][scene]["scale"] - 1) for scene in SCENES} for model in models}
    worst = sum(max(of, key=lambda scene: of[scene]) == "csd" for of in off.values())
    largest = max(off.values(), key=lambda of: of["csd"])["csd"]
    text = (
        f"median ratio of completed to true depth: in CSD off by {100 * largest:.1f} % at most, farthest from one "
        f"there for {worst} of {len(models)} networks"
    )
    return text, "reproduced" if worst == len(models) else "not reproduced"
