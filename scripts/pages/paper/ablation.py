"""The page's parts on Table II: the rows, by how much each is below another, and choices of training."""

from itertools import product

from benchmarks.paper.claims import SCENE_NAMES, Reduction, finding
from benchmarks.paper.plan import (
    AS_SAVED,
    AT_LENGTH,
    BODIES,
    CHANGES,
    FLOAT32,
    IN_METRES,
    PAPER_SIZE,
    PAPER_STEPS,
    READINGS,
    RESIDUAL,
    ROWS,
    SEEDS,
    TRAINED_ON,
    TRAININGS,
    UNTRAINED,
    Run,
    Training,
)
from benchmarks.paper.published import FIGURE_NAMES, TABLE_2, reduction
from benchmarks.paper.records import Records
from scripts.pages.paper.in_words import FULL, higher_by, machine
from scripts.pages.paper.networks import FLOORS, spread

COMPARED = (("+SA", "baseline"), ("+MSC", "baseline"), ("full", "baseline"), ("full", "+MSC"))
SA_COMPARED = {
    "sa_abs_rel": ("full", "+MSC", "abs_rel"),
    "sa_rmse": ("full", "+MSC", "rmse"),
    "sa_alone": ("+SA", "baseline", "abs_rel"),
}
COLUMNS = "| RMSE [mm] | abs.REL [%] | abs.REL, median frame [%] | MAE [mm] | delta 1 | seeds |\n" + "|---" * 7 + "|"


def cells_of(records: Records, scene: str, label: str, run: Run) -> str:
    """One network's cells: RMSE, abs.REL (mean and median frame), MAE, delta 1, seeds."""
    median = records.median_frame(scene, run, "abs_rel")
    cells = [
        label,
        spread(records.mean(scene, run, "rmse")),
        spread(records.mean(scene, run, "abs_rel"), 100),
        "-" if median is None else f"{100 * median:.2f}",
        spread(records.mean(scene, run, "mae")),
        spread(records.mean(scene, run, "delta_1"), 1, 4),
        str(len(records.of(run))) if run.model not in UNTRAINED else "",
    ]
    return f"| {' | '.join(cells)} |"


def rows_of(records: Records, scene: str, training: Training) -> list[str]:
    """The rows of a training that are recorded."""
    runs = training.runs(scene).items()
    return [cells_of(records, scene, f"{training.label}: {row}", run) for row, run in runs if records.of(run)]


def table_2(records: Records, scene: str) -> list[str]:
    """Four rows of each body, residual rows and what needs no training."""
    lines = [f"### {SCENE_NAMES[scene].capitalize()}", "", f"| {scene.replace('_', ' ')} {COLUMNS}"]
    lines += [line for body in BODIES for line in rows_of(records, scene, Training(body))]
    others: dict[str, str] = {}
    if scene == "colon":
        lines += rows_of(records, scene, IN_METRES)
        others = {model: f"U-Net, {name}: full, residual" for name, model in RESIDUAL.items()}
    lines += [cells_of(records, scene, name, Run((scene,), model)) for model, name in (others | FLOORS).items()]
    trainings = [training for training in TRAININGS[scene] if training.steps != PAPER_STEPS]
    return [*lines, "", *reductions(records, scene, trainings)]


def reductions(records: Records, scene: str, trainings: list[Training]) -> list[str]:
    """Rows below others, by training, with the number of seeds; the paper's own first; then the order of the rows."""
    labels = " | ".join(training.label.replace(f", {PAPER_STEPS:,} steps", "") for training in trainings)
    lines = [f"| {SCENE_NAMES[scene]}: reduction [%] (seeds) | paper | {labels} |", "|---" * (2 + len(trainings)) + "|"]
    for name, beside, figure in product_of_reductions():
        cells = [
            f"{FIGURE_NAMES[figure]} of {name} below {beside}",
            f"{100 * reduction(scene, name, beside, figure):.1f}",
        ]
        for training in trainings:
            found = finding(records, Reduction(scene, name, beside, figure), training)
            cells.append("-" if found is None else f"{spread(found[0], 100, 1)} ({found[1]})")
        lines.append(f"| {' | '.join(cells)} |")
    for figure in ("abs_rel", "rmse"):
        cells = [order_cell(records, scene, training, figure) for training in trainings]
        published = " < ".join(published_order(scene, figure))
        lines.append(f"| order in {FIGURE_NAMES[figure]}, by the means | {published} | {' | '.join(cells)} |")
    return lines


def product_of_reductions() -> list[tuple[str, str, str]]:
    """Row, the row that it is compared with, and figure, as the tables list them."""
    return [(*rows, figure) for rows, figure in product(COMPARED, ("abs_rel", "rmse", "mae"))]


def seeds_of_all_rows(records: Records, scene: str, training: Training) -> set[int]:
    """Seeds of which all four rows have a record."""
    return set.intersection(*(set(records.of(run)) for run in training.runs(scene).values()))


def order(records: Records, scene: str, training: Training, figure: str) -> list[str]:
    """Rows by the mean of a figure over the seeds that all four have, lowest first; empty without such a seed."""
    shared = seeds_of_all_rows(records, scene, training)
    runs = training.runs(scene).items() if shared else []
    means = {row: float(records.table(scene, run, figure, shared).mean()) for row, run in runs}
    return sorted(means, key=lambda row: means[row])


def order_cell(records: Records, scene: str, training: Training, figure: str) -> str:
    """The order with the number of its seeds."""
    found = " < ".join(order(records, scene, training, figure))
    return f"{found} ({len(seeds_of_all_rows(records, scene, training))})" if found else "-"


def published_order(scene: str, figure: str) -> list[str]:
    """The paper's rows, lowest first."""
    return sorted(ROWS, key=lambda row: TABLE_2[scene][row][figure])


def every_training() -> list[tuple[str, Training]]:
    """Of both scenes, which stands before it."""
    return [(scene, training) for scene, trainings in TRAININGS.items() for training in trainings]


def in_published_order(records: Records) -> dict[str, str]:
    """In how many trainings the rows have the paper's order of abs.REL, and in how many the first two have."""
    orders = [
        (found, published_order(scene, "abs_rel"))
        for scene, training in every_training()
        if (found := order(records, scene, training, "abs_rel"))
    ]
    all_four, first = sum(ours == of for ours, of in orders), sum(ours[:2] == of[:2] for ours, of in orders)
    return {"in_order": f"{all_four} of {len(orders)}", "in_order_first": str(first)}


def counts(records: Records, name: str, beside: str, figure: str) -> tuple[int, int, int]:
    """In how many trainings of both scenes that have `SEEDS` seeds a row is lower and higher by more than the
    interval, and how many these are."""
    found = [finding(records, Reduction(scene, name, beside, figure), of) for scene, of in every_training()]
    known = [of[0] for of in found if of and of[1] >= SEEDS]
    return sum(of.low > 0 for of in known), sum(of.high < 0 for of in known), len(known)


def counted(records: Records, name: str, beside: str, figure: str) -> str:
    """The same in words."""
    lower, higher, known = counts(records, name, beside, figure)
    return f"lower in {lower} of {known} trainings and higher in {higher}"


def closer(records: Records, ours: Training, source: Training) -> str:
    """Which of the colon's reductions below the baseline, by MSC alone and by full, are closer to the paper's in the
    one training, and which in the other."""
    near: dict[bool, list[str]] = {True: [], False: []}
    for name, beside, figure in product_of_reductions():
        of = Reduction("colon", name, beside, figure)
        both = [finding(records, of, training) for training in (ours, source)]
        if name != "+SA" and beside == "baseline" and both[0] and both[1]:
            published = reduction("colon", name, beside, figure)
            first, second = (abs(found[0].value - published) for found in both if found)
            near[first < second].append(f"{FIGURE_NAMES[figure]} of {name}")
    texts = (", ".join(names) or "none" for names in (near[True], near[False]))
    return "Closer to the paper's reduction with our unit and rate: {}; with the source's: {}".format(*texts)


def sa_beyond(records: Records) -> str:
    """How many of the comparisons of `counted` that the page makes on SA leave zero out, and of how many."""
    found = [counts(records, *of) for of in SA_COMPARED.values()]
    return f"{sum(lower + higher for lower, higher, _ in found)} of {sum(known for _, _, known in found)}"


def length(records: Records) -> list[str]:
    """The paper's number of steps, on the colon: ours beside it, then changed trainings of early fusion."""
    lines = [f"| colon {COLUMNS}"]
    for training in AT_LENGTH:
        shorter, longer = Training(training.body).runs("colon"), training.runs("colon")
        for row, run in longer.items():
            if records.of(run):
                lines.append(
                    cells_of(records, "colon", f"{training.body}: {row}, {shorter[row].steps:,} steps", shorter[row])
                )
                lines.append(cells_of(records, "colon", f"{training.body}: {row}, {run.steps:,} steps", run))
    changed = [training for training in TRAININGS["colon"] if training.steps == PAPER_STEPS and training.change]
    lines += [line for training in changed for line in rows_of(records, "colon", training)]
    at_length = [training for training in TRAININGS["colon"] if training.steps == PAPER_STEPS]
    return [*lines, "", *reductions(records, "colon", at_length)]


def changes(records: Records) -> list[str]:
    """Choices of training, one at a time."""
    first, second = COLUMNS.split("\n")
    lines = [f"| early fusion, full, colon {first} abs.REL higher by | on |", f"{second}---|---|"]
    runs = {"as above": Run(("colon",), FULL), "as above, on a CPU": Run(("colon",), FULL, change=AS_SAVED)}
    thrice = {"judged in float32": FLOAT32, "judged on frames that were trained on": TRAINED_ON}
    runs |= {f"the second row, {how}": Run(("colon",), FULL, change=of) for how, of in thrice.items()}
    runs |= {of: Run(("colon",), FULL, change=of) for of in CHANGES}
    runs |= {label: Run(("colon",), model) for label, model in READINGS.items()}
    runs["320 px, as many points and steps"] = Run(("colon",), FULL, side=PAPER_SIZE)
    for label, run in runs.items():
        higher = "" if run.change == TRAINED_ON else higher_by(records, run)
        lines.append(f"{cells_of(records, 'colon', label, run)} {higher} | {machine(records, run)} |")
    return lines
