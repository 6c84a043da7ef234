"""What our records say of the paper's sentences on Table I and Figure 5: the figures, and a finding that follows.

The words of a finding are those of `claims.verdict`; a sentence without an interval of its own is *reproduced* or *not
reproduced* by the means.
"""

from collections.abc import Callable

import numpy as np

from benchmarks.paper.intervals import Interval
from benchmarks.paper.plan import FIGURE_5, MOST_STEPS, OTHER_PARAMETERS, OURS, POINT_COUNTS, RIVALS, SCENES, Run
from benchmarks.paper.published import TABLE_1
from benchmarks.paper.records import Records

PRINTED_SCENES = {"colon": "colon", "small_intestine": "small intestine", "ccd": "CCD", "csd": "CSD"}
PRINTED = "mscsa-plain"  # the network whose rows stand for the paper's in sentences about several networks
NAMES = {
    "std18": "StD-ResNet18",
    "std50": "StD-ResNet50",
    "gaenet": "GAENet",
    "nlspn": "NLSPN",
    "mscsa-plain": "MSCSA-Net, plain U-Net",
    "mscsa-early-fusion": "MSCSA-Net, early fusion",
    "mscsa+residual": "MSCSA-Net, U-Net with batch normalisation, residual",
    "mscsa-plain+residual": "MSCSA-Net, plain U-Net, residual",
}
Found = tuple[str, str]  # what was measured, and the finding
Judge = Callable[[Records], Found | None]


def row(model: str, size: str = "small") -> Run:
    """A row of Table I."""
    return Run(tuple(SCENES), model, 0, MOST_STEPS, size=size, converged=True)


def named_rivals() -> dict[str, Run]:
    """Rivals at equal computation, and at equal parameters where that is another network, by their names in tables."""
    rivals = {NAMES[model]: row(model) for model in RIVALS}
    return rivals | {f"{NAMES[model]}, as many parameters": row(model, "same-parameters") for model in OTHER_PARAMETERS}


def means(records: Records, figure: str, models: tuple[str, ...]) -> dict[str, dict[str, float]] | None:
    """By model and scene; None unless each has a record."""
    found = {
        model: {scene: known.value for scene in SCENES if (known := records.mean(scene, row(model), figure))}
        for model in models
    }
    return found if all(len(of) == len(SCENES) for of in found.values()) else None


def reductions_below(scene: str, rival: str) -> Judge:
    """RMSE, abs.REL and MAE of ours below a rival's, and what each interval says of the paper's figure."""

    def judge(records: Records) -> Found | None:
        cells = []
        for figure, name in (("rmse", "RMSE"), ("abs_rel", "abs.REL"), ("mae", "MAE")):
            found = records.reduction(scene, row(PRINTED), row(rival), figure)
            if found is None:
                return None
            published = TABLE_1[scene]
            claimed = 1 - published["MSCSA-Net"][figure] / published[NAMES[rival]][figure]
            cells.append((name, *found, found[0].word(claimed)))
        text = ", ".join(f"{name} {percent(interval)}" for name, interval, _, _ in cells)
        words = ", ".join(f"{name} {word}" for name, _, _, word in cells)
        return text, f"{words}, {cells[0][2]} seed{'s' * (cells[0][2] > 1)}; see what Table I can say"

    return judge


def larger_in_small_intestine(rival: str) -> Judge:
    """Whether ours is farther below a rival in the small intestine than in the colon, by the means."""

    def judge(records: Records) -> Found | None:
        cells, larger = [], []
        for figure, name in (("rmse", "RMSE"), ("abs_rel", "abs.REL"), ("mae", "MAE")):
            both = [records.reduction(s, row(PRINTED), row(rival), figure) for s in ("small_intestine", "colon")]
            if both[0] is None or both[1] is None:
                return None
            values = [100 * found[0].value for found in both if found]
            cells.append(f"{name} {values[0]:.1f} % against {values[1]:.1f} %")
            larger.append(values[0] > values[1])
        finding = "reproduced" if all(larger) else "not reproduced" if not any(larger) else "not in all three"
        return ", ".join(cells), f"{finding}, by the means"

    return judge


def best_rival_in_colon(records: Records) -> Found | None:
    """Whether GAENet is the best rival in the colon."""
    found = means(records, "abs_rel", RIVALS)
    if found is None:
        return None
    order = sorted(RIVALS, key=lambda model: found[model]["colon"])
    elsewhere = ", ".join(f"{PRINTED_SCENES[s]} {100 * found['gaenet'][s]:.1f} %" for s in SCENES if s != "colon")
    text = f"GAENet elsewhere: {elsewhere}; abs.REL in the colon: " + ", ".join(
        f"{NAMES[m]} {100 * found[m]['colon']:.1f} %" for m in order
    )
    return text, f"{'reproduced' if order[0] == 'gaenet' else 'not reproduced'}, by the means"


def colon_is_easiest(records: Records) -> Found | None:
    """For how many networks the colon has the lowest error."""
    models = (*OURS, *RIVALS)
    counts = []
    for figure in ("rmse", "abs_rel"):
        found = means(records, figure, models)
        if found is None:
            return None
        counts.append(sum(min(of, key=lambda scene: of[scene]) == "colon" for of in found.values()))
    text = f"lowest RMSE in the colon for {counts[0]} of {len(models)} networks, lowest abs.REL for {counts[1]}"
    return text, f"{'reproduced' if min(counts) == len(models) else 'not reproduced'}, by the means"


def delta_1_on(scene: str, models: tuple[str, ...]) -> Judge:
    """delta 1 of networks on a scene: whose is lower; the values depend on the data."""

    def judge(records: Records) -> Found | None:
        found = means(records, "delta_1", models)
        if found is None:
            return None
        text = ", ".join(f"{NAMES[m]} {found[m][scene]:.4f}" for m in models)
        if len(models) == 1:
            return text, "other data"
        behind = "is behind ours, too" if found[models[0]][scene] < found[models[1]][scene] else "is not behind ours"
        return text, f"{NAMES[models[0]]} {behind}, by the means; the values are of other data"

    return judge


def leads_in_delta_1(least: float, mean: bool) -> Judge:
    """delta 1 of ours less that of the best rival, by scene: all at least `least`, or their mean."""

    def judge(records: Records) -> Found | None:
        found = means(records, "delta_1", (PRINTED, *RIVALS))
        if found is None:
            return None
        leads = {}
        for scene in SCENES:
            others = [records.mean(scene, run, "delta_1") for run in named_rivals().values()]
            leads[scene] = found[PRINTED][scene] - max(other.value for other in others if other)
        average = float(np.mean(list(leads.values())))
        reached = average if mean else min(leads.values())
        text = ", ".join(f"{PRINTED_SCENES[scene]} {lead:.4f}" for scene, lead in leads.items())
        text = f"beside the best rival row of Table I: {text}"
        return f"{text}; mean {average:.4f}", f"{'reproduced' if reached >= least else 'not reproduced'}, by the means"

    return judge


def points(count: int, sampler: str) -> Run:
    """A run of Figure 5."""
    return Run(("colon",), FIGURE_5, points=count, sampler=sampler)


def steeper_for_uniform(records: Records) -> Found | None:
    """delta 1 from the fewest to the most points."""
    found = {}
    for sampler in ("uniform", "features"):
        known = [records.mean("colon", points(count, sampler), "delta_1") for count in POINT_COUNTS]
        if any(one is None for one in known):
            return None
        found[sampler] = [one.value for one in known if one]
    texts = (f"{sampler} {', '.join(f'{value:.4f}' for value in values)}" for sampler, values in found.items())
    rises = all(values == sorted(values) for values in found.values())
    steeper = found["uniform"][-1] - found["uniform"][0] > found["features"][-1] - found["features"][0]
    finding = "reproduced" if rises and steeper else "it rises, but for features more" if rises else "not reproduced"
    return f"delta 1 at {', '.join(f'{count:,}' for count in POINT_COUNTS)} points: {'; '.join(texts)}", finding


def growth_with_features(records: Records) -> Found | None:
    """How much delta 1 rises from 10 to 1,000 and on to 10,000 points, features beside uniform ones."""
    rises = {}
    for sampler in ("features", "uniform"):
        few, many, most = (records.mean("colon", points(n, sampler), "delta_1") for n in (10, 1000, 10_000))
        if few is None or many is None or most is None:
            return None
        rises[sampler] = many.value - few.value, most.value - many.value
    text = "; ".join(f"{s} {a:.4f} to 1,000 points and {b:.4f} from there to 10,000" for s, (a, b) in rises.items())
    less = rises["features"][0] < rises["uniform"][0]
    return f"delta 1 rises from 10 points on: {text}", f"{'reproduced' if less else 'not reproduced'}, by the means"


def features_higher(records: Records, count: int) -> Interval | None:
    """By how much abs.REL of feature points is above that of uniform ones, as a fraction."""
    found = records.reduction("colon", points(count, "features"), points(count, "uniform"), "abs_rel")
    return None if found is None else Interval(-found[0].value, -found[0].high, -found[0].low)


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


def percent(interval: Interval) -> str:
    """A fraction with its interval."""
    return f"{100 * interval.value:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}] %"
