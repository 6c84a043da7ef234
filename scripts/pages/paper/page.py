"""docs/lab/paper.md from benchmarks/results/paper/*.json: the paper's claims beside our records.

The words are in words.txt; every figure that we measured comes from the records.

python -m scripts.pages.paper.page > docs/lab/paper.md
"""

import json
import textwrap
from collections import Counter
from itertools import product
from pathlib import Path
from string import Template

from benchmarks.paper.claims import SCENE_NAMES, claims, finding, verdict
from benchmarks.paper.judgements import NAMES, features_higher, percent, points
from benchmarks.paper.plan import (
    AS_SAVED,
    BODIES,
    CHANGES,
    FLOAT32,
    MOST_STEPS,
    NORMALISATIONS,
    PAPER_LENGTH,
    PAPER_SIZE,
    PAPER_STEPS,
    POINT_COUNTS,
    READINGS,
    RESIDUAL,
    ROWS,
    STEPS,
    TRAINED_ON,
    UNTRAINED,
    Run,
)
from benchmarks.paper.published import TABLE_2, reduction
from benchmarks.paper.records import FIGURES, Record, Records
from scripts.pages.paper.in_words import FULL, higher_by, machine
from scripts.pages.paper.in_words import figures as figures_in_words
from scripts.pages.paper.networks import (
    FLOORS,
    cost_of_batches,
    equal_steps,
    lead_over_best_rival,
    median_frames,
    seen_in_figure_4,
    spread,
    table_1,
)

WORDS = Path(__file__).with_name("words.txt")


def row(records: Records, scene: str, label: str, model: str, change: str = "", steps: int = STEPS) -> str:
    """The cells of a network that one scene was trained on."""
    return cells_of(records, scene, label, Run((scene,), model, change=change, steps=steps))


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


COLUMNS = "| RMSE [mm] | abs.REL [%] | abs.REL, median frame [%] | MAE [mm] | delta 1 | seeds |\n" + "|---" * 7 + "|"


def table_2(records: Records, scene: str) -> list[str]:
    """Four rows of each body, the paper's own, residual rows and what needs no training."""
    lines = [f"### {SCENE_NAMES[scene].capitalize()}", "", f"| {scene.replace('_', ' ')} {COLUMNS}"]
    for body, models in BODIES.items():
        lines += [row(records, scene, f"{body}: {name}", model) for name, model in zip(ROWS, models, strict=True)]
    if scene == "colon":
        lines += [row(records, scene, f"U-Net, {name}: full, residual", model) for name, model in RESIDUAL.items()]
    lines += [row(records, scene, name, label) for label, name in FLOORS.items()]
    return lines


def reductions(records: Records, scene: str, steps: int = STEPS) -> list[str]:
    """Full below the baseline, and below MSC alone, by body."""
    bodies = " | ".join(BODIES)
    lines = [f"| {SCENE_NAMES[scene]}: reduction [%] | paper | {bodies} |", "|---" * (2 + len(BODIES)) + "|"]
    for name, beside in (("+SA", "baseline"), ("+MSC", "baseline"), ("full", "baseline"), ("full", "+MSC")):
        for figure, title in (("abs_rel", "abs.REL"), ("rmse", "RMSE"), ("mae", "MAE")):
            cells = [f"{title} of {name} below {beside}", f"{100 * reduction(scene, name, beside, figure):.1f}"]
            for models in BODIES.values():
                runs = {n: Run((scene,), model, steps=steps) for n, model in zip(ROWS, models, strict=True)}
                found = records.reduction(scene, runs[name], runs[beside], figure)
                cells.append("-" if found is None else spread(found[0], 100, 1))
            lines.append(f"| {' | '.join(cells)} |")
    return lines


def normalisations(records: Records) -> list[str]:
    """The full network on the U-Net, changed in one thing."""
    columns = ["normalisation", "abs.REL [%]", "RMSE [mm]", "MSC's depth [%]", "in training mode [%]", "companions [%]"]
    lines = [f"| {' | '.join([*columns, 'seeds'])} |", "|---" * (len(columns) + 1) + "|"]
    for label, model in NORMALISATIONS.items():
        run = Run(("colon",), model)
        runs = records.of(run)
        effects = [effect for run in runs.values() if (effect := run["scenes"]["colon"]["batch_statistics"])]
        means = [
            f"{100 * sum(effect[key] for effect in effects) / len(effects):.2f}" if effects else "-"
            for key in ("abs_rel", "companions")
        ]
        figures = [spread(records.mean("colon", run, "abs_rel"), 100), spread(records.mean("colon", run, "rmse"))]
        own = spread(records.mean("colon", run, "msc_abs_rel"), 100, 1)
        lines.append(f"| {' | '.join([label, *figures, own, *means, str(len(runs))])} |")
    return lines


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


def sentences(records: Records) -> list[str]:
    """Each sentence beside what the paper's own tables say and what we find on each body."""
    lines = ["| the paper's sentence | its own tables | ours | finding |", "|---|---|---|---|"]
    for claim in claims():
        measured: list[str] = []
        findings: list[str] = []
        if claim.judge and (judged := claim.judge(records)):
            measured, findings = [judged[0]], [judged[1]]
        for of in claim.compared[:1]:
            claimed = reduction(of.scene, of.row, of.beside, of.figure)
            if len(claim.compared) > 1:
                findings.append(f"beside {100 * claimed:.1f} %")
            for steps, body in product((STEPS, PAPER_STEPS), BODIES):
                name = body if steps == STEPS else f"{body}, {steps:,} steps"
                found = finding(records, of, body, steps)
                measured += [f"{name}: {spread(found[0], 100, 1)} %"] if found else []
                findings += [f"{name}: {verdict(found, claimed)}"] if found else []
        found_text = "; ".join(findings) or "not measured"
        lines.append(f"| {claim.text} | {claim.own} | {'; '.join(measured)} | {found_text} |")
    return lines


def figure_5(records: Records) -> list[str]:
    """Errors by the number of uniform and of feature points."""
    lines = ["| points | of 25,600 px | abs.REL, uniform [%] | abs.REL, features [%] | features instead of uniform |"]
    lines += ["|---|---|---|---|---|"]
    for count in POINT_COUNTS:
        uniform, features = (points(count, sampler) for sampler in ("uniform", "features"))
        cells = [spread(records.mean("colon", run, "abs_rel"), 100) for run in (uniform, features)]
        found = features_higher(records, count)
        higher = f"{percent(found)} higher" if found else "-"
        share = f"{count / 256:.2g} %"
        lines.append(f"| {count:,} | {share} | {' | '.join(cells)} | {higher} |")
    return lines


def sa_change() -> list[str]:
    """What SA adds to the features that it is given."""
    lines = [
        "| scene | network | added, of the features' norm | of it one map | largest weight |",
        "|---|---|---|---|---|",
    ]
    for scene, models in json.loads(FIGURES.read_text())["figure_6"]["sa_change"].items():
        for model, of in models.items():
            cells = (
                f"{100 * of['added']:.0f} % | {100 * of['one_map']:.1f} % | {of['largest_weight']:.2f} of equal ones"
            )
            lines.append(f"| {SCENE_NAMES[scene]} | {NAMES[model]} | {cells} |")
    return lines


def keypoints() -> str:
    """SIFT keypoints of a judged frame: median and range."""
    of = json.loads(FIGURES.read_text())["figure_6"]["keypoints"]
    return f"{of['median']:.0f} ({of['least']}-{of['most']})"


def length(records: Records) -> list[str]:
    """The paper's number of steps beside ours."""
    done = [model for model in PAPER_LENGTH if records.of(Run(("colon",), model, steps=PAPER_STEPS))]
    if not done:
        return [f"No training of {PAPER_STEPS:,} steps is recorded."]
    lines = [f"| colon {COLUMNS}"]
    names = {m: f"{body}: {name}" for body, of in BODIES.items() for name, m in zip(ROWS, of, strict=True)}
    for model in done:
        for steps in (STEPS, PAPER_STEPS):
            lines.append(row(records, "colon", f"{names[model]}, {steps:,} steps", model, steps=steps))
    return [*lines, "", *reductions(records, "colon", PAPER_STEPS)]


def provenance(records: Records) -> list[str]:
    """Commits, machines and number of the records."""
    trained = [record for record in records.records if record["model"] not in UNTRAINED]
    commits = sorted({commit[:7] + "+" * commit.endswith("+") for r in records.records if (commit := commit_of(r))})
    counts = Counter(record["environment"].get("gpu") or record["environment"]["processor"] for record in trained)
    machines = ", ".join(f"{count} on `{name}`" for name, count in sorted(counts.items()))
    moved = [record["steps_on"] for record in trained if len(record.get("steps_on", {})) > 1]
    went_on = "".join(
        f" One went on elsewhere: {' and '.join(f'{steps:,} steps on {name}' for name, steps in of.items())}."
        for of in moved
    )
    text = (
        f"{len(trained)} judgements are recorded, two trainings being judged thrice: {machines}; commits "
        f"{', '.join(commits)} (+: with changes that were not committed).{went_on}"
    )
    return textwrap.wrap(text, 118, break_on_hyphens=False)


def commit_of(record: Record) -> str:
    """Where a record was made."""
    return str(record["environment"]["commit"])


def page(records: Records) -> str:
    """The whole page."""
    tables = [[*table_2(records, scene), "", *reductions(records, scene), ""] for scene in TABLE_2]
    parts = {
        "provenance": provenance(records),
        "sentences": sentences(records),
        "table_2": [line for lines in tables for line in lines][:-1],
        "normalisations": normalisations(records),
        "changes": changes(records),
        "table_1": [
            *table_1(records, "abs_rel", "abs.REL [%]", 100),
            *["", *table_1(records, "rmse", "RMSE [mm]", 1)],
            *["", *median_frames(records)],
        ],
        "seen_in_figure_4": seen_in_figure_4(),
        **{name: [text] for name, text in figures_in_words(records).items()},
        "lead": [lead_over_best_rival(records)],
        "cost_of_batches": [cost_of_batches(records)],
        "equal_steps": equal_steps(records),
        "figure_5": figure_5(records),
        "length": length(records),
        "sa_change": sa_change(),
        "keypoints": [keypoints()],
        "steps": [f"{STEPS:,}"],
        "most_steps": [f"{MOST_STEPS:,}"],
    }
    words = Template(WORDS.read_text(encoding="utf-8"))
    return words.substitute({name: "\n".join(lines) for name, lines in parts.items()})


if __name__ == "__main__":
    print(page(Records.read()), end="")
