"""What our records say of the paper's sentences on Table I: the figures with intervals, and a finding that follows."""

from collections.abc import Callable

import numpy as np

from benchmarks.paper.intervals import Interval, apart_interval, mean_interval, reductions_apart_interval
from benchmarks.paper.plan import MOST_STEPS, OTHER_PARAMETERS, OURS, RIVALS, SCENES, Run
from benchmarks.paper.published import FIGURE_NAMES, LOWERED, TABLE_1
from benchmarks.paper.records import Records
from haustra.core.text import counted

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
        for figure in LOWERED:
            found = records.reduction(scene, row(PRINTED), row(rival), figure)
            if found is None:
                return None
            published = TABLE_1[scene]
            claimed = 1 - published["MSCSA-Net"][figure] / published[NAMES[rival]][figure]
            cells.append((FIGURE_NAMES[figure], *found, found[0].word(claimed)))
        text = ", ".join(f"{name} {percent(interval)}" for name, interval, _, _ in cells)
        words = ", ".join(f"{name} {word}" for name, _, _, word in cells)
        return text, f"{words}, {counted(cells[0][2], 'seed')}; see what Table I can say"

    return judge


def larger_in_small_intestine(rival: str) -> Judge:
    """Whether ours is farther below a rival in the small intestine than in the colon."""

    def judge(records: Records) -> Found | None:
        cells, words = [], []
        for figure in LOWERED:
            there, here = (records.pair(s, row(PRINTED), row(rival), figure) for s in ("small_intestine", "colon"))
            if there is None or here is None:
                return None
            more = reductions_apart_interval(there, here)
            cells.append(f"{FIGURE_NAMES[figure]} {in_points(more)}")
            words.append(f"{FIGURE_NAMES[figure]} {more.finding}")
        return f"reduction there less that in the colon: {', '.join(cells)}", ", ".join(words)

    return judge


def best_rival_in_colon(records: Records) -> Found | None:
    """Whether GAENet is the best rival in the colon."""
    found = means(records, "abs_rel", RIVALS)
    if found is None:
        return None
    order = sorted(RIVALS, key=lambda model: found[model]["colon"])
    best = next(model for model in order if model != "gaenet")
    tables = records.pair("colon", row(best), row("gaenet"), "abs_rel")
    if tables is None:
        return None
    lower = mean_interval(tables[0] - tables[1])
    elsewhere = ", ".join(f"{PRINTED_SCENES[s]} {100 * found['gaenet'][s]:.1f} %" for s in SCENES if s != "colon")
    colon = ", ".join(f"{NAMES[m]} {100 * found[m]['colon']:.1f} %" for m in order)
    text = f"GAENet elsewhere: {elsewhere}; abs.REL in the colon: {colon}; {NAMES[best]} less GAENet {in_points(lower)}"
    return text, lower.finding


def colon_is_easiest(records: Records) -> Found | None:
    """For how many networks the colon has the lowest error: beside the easiest other scene, of other meshes."""
    models = (*OURS, *RIVALS)
    texts, intervals = [], []
    for figure in ("rmse", "abs_rel"):
        found = means(records, figure, models)
        if found is None:
            return None
        below = []
        for model, of in found.items():
            other = min((scene for scene in SCENES if scene != "colon"), key=lambda scene: of[scene])
            below.append(apart_interval(*(records.table(s, row(model), figure) for s in (other, "colon"))))
        lower, higher = sum(i.low > 0 for i in below), sum(i.high < 0 for i in below)
        texts.append(
            f"{FIGURE_NAMES[figure]} lower in the colon for {lower} of {len(models)} networks, higher for {higher}"
        )
        intervals += below
    if all(i.low > 0 for i in intervals):
        finding = "reproduced"
    else:
        finding = "not reproduced" if any(i.high < 0 for i in intervals) else "not decided"
    return f"beside the easiest other scene, beyond the interval: {'; '.join(texts)}", finding


def delta_1_on(scene: str, models: tuple[str, ...]) -> Judge:
    """delta 1 of networks on a scene: by how much the first is behind the last; the values depend on the data."""

    def judge(records: Records) -> Found | None:
        found = means(records, "delta_1", models)
        if found is None:
            return None
        text = ", ".join(f"{NAMES[m]} {found[m][scene]:.4f}" for m in models)
        tables = records.pair(scene, row(models[-1]), row(models[0]), "delta_1")
        if len(models) == 1 or tables is None:
            return text, "other data"
        behind = mean_interval(tables[0] - tables[1])
        return f"{text}: {in_digits(behind)} behind", f"that it is behind: {behind.finding}; values of other data"

    return judge


def leads_in_delta_1(least: float, mean: bool) -> Judge:
    """delta 1 of ours less that of the best rival, by scene: all at least `least`, or their mean."""

    def judge(records: Records) -> Found | None:
        ahead = {}
        for scene in SCENES:
            rivals = [(m.value, run) for run in named_rivals().values() if (m := records.mean(scene, run, "delta_1"))]
            best = max(rivals, key=lambda rival: rival[0], default=None)
            tables = records.pair(scene, row(PRINTED), best[1], "delta_1") if best else None
            if tables is None:
                return None
            ahead[scene] = tables[0] - tables[1]
        leads = {scene: mean_interval(table) for scene, table in ahead.items()}
        seeds = min(len(table) for table in ahead.values())
        average = mean_interval(np.concatenate([table[:seeds] for table in ahead.values()], axis=1))
        text = ", ".join(f"{PRINTED_SCENES[scene]} {in_digits(lead)}" for scene, lead in leads.items())
        finding = average.word(least)
        if not mean:
            short = any(lead.high < least for lead in leads.values())
            finding = "not reproduced" if short else "not decided"
            finding = "reproduced" if all(lead.low >= least for lead in leads.values()) else finding
        return f"beside the best rival row of Table I: {text}; mean {in_digits(average)}", finding

    return judge


def in_points(interval: Interval) -> str:
    """A difference of fractions with its interval, in percentage points."""
    return f"{percent(interval).removesuffix(' %')} points"


def in_digits(interval: Interval) -> str:
    """A difference of delta 1 with its interval."""
    return f"{interval.value:.4f} [{interval.low:.4f}, {interval.high:.4f}]"


def percent(interval: Interval) -> str:
    """A fraction with its interval."""
    return f"{100 * interval.value:.1f} [{100 * interval.low:.1f}, {100 * interval.high:.1f}] %"
