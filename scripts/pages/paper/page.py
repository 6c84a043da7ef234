"""docs/lab/paper.md from benchmarks/results/paper/*.json: the paper's claims beside our records.

The words are in words.txt; every figure that we measured comes from the records.

python -m scripts.pages.paper.page > docs/lab/paper.md
"""

import json
import textwrap
from collections import Counter
from pathlib import Path
from string import Template

from benchmarks.paper.claims import SCENE_NAMES, claims, finding, verdict
from benchmarks.paper.judgements import NAMES, percent
from benchmarks.paper.judgements_figures import features_higher, points
from benchmarks.paper.plan import (
    AS_ITS_SOURCE,
    AT_LENGTH,
    MOST_STEPS,
    NORMALISATIONS,
    POINT_COUNTS,
    STEPS,
    TRAININGS,
    UNTRAINED,
    Run,
)
from benchmarks.paper.published import TABLE_2, reduction
from benchmarks.paper.records import FIGURES, Record, Records
from scripts.pages.paper.ablation import (
    SA_COMPARED,
    changes,
    closer,
    counted,
    in_published_order,
    length,
    sa_beyond,
    table_2,
)
from scripts.pages.paper.in_words import figures as figures_in_words
from scripts.pages.paper.networks import (
    cost_of_batches,
    equal_steps,
    lead_over_best_rival,
    median_frames,
    seen_in_figure_4,
    spread,
    table_1,
)

WORDS = Path(__file__).with_name("words.txt")


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
            for training in TRAININGS[of.scene]:
                found = finding(records, of, training)
                measured += [f"{training.label}: {spread(found[0], 100, 1)} %"] if found else []
                findings += [f"{training.label}: {verdict(found, claimed)}"] if found else []
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


def provenance(records: Records) -> list[str]:
    """Commits, machines and number of the records."""
    trained = [record for record in records.records if record["model"] not in UNTRAINED]
    commits = sorted({commit[:7] + "+" * commit.endswith("+") for r in records.records if (commit := commit_of(r))})
    counts = Counter(record["environment"].get("gpu") or record["environment"]["processor"] for record in trained)
    machines = ", ".join(f"{count} on `{name}`" for name, count in sorted(counts.items()))
    moved = [record for record in trained if len(record.get("steps_on", {})) > 1]
    went_on = "; ".join(f"{name_of(r)}: {' and '.join(parts_of(r))}" for r in moved)
    went_on = f" Trainings that went on elsewhere: {went_on}." if moved else ""
    text = (
        f"{len(trained)} judgements are recorded, two trainings being judged thrice: {machines}; commits "
        f"{', '.join(commits)} (+: with changes that were not committed).{went_on}"
    )
    return textwrap.wrap(text, 118, break_on_hyphens=False)


def name_of(record: Record) -> str:
    """A training, in words."""
    change = f", {record['change']}" if record["change"] else ""
    return f"`{record['model']}`{change}, at most {record['steps']:,} steps, seed {record['seed']}"


def parts_of(record: Record) -> list[str]:
    """How many of its steps were made on which device."""
    return [f"{steps:,} steps on {name.replace('cpu', 'a CPU')}" for name, steps in record["steps_on"].items()]


def commit_of(record: Record) -> str:
    """Where a record was made."""
    return str(record["environment"]["commit"])


def page(records: Records) -> str:
    """The whole page."""
    tables = [[*table_2(records, scene), ""] for scene in TABLE_2]
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
        **{name: [text] for name, text in (figures_in_words(records) | in_published_order(records)).items()},
        "lead": [lead_over_best_rival(records)],
        "cost_of_batches": [cost_of_batches(records)],
        "equal_steps": equal_steps(records),
        "figure_5": figure_5(records),
        "length": length(records),
        "sa_change": sa_change(),
        "keypoints": [keypoints()],
        **{name: [counted(records, *of)] for name, of in SA_COMPARED.items()},
        "sa_out": [sa_beyond(records)],
        "closer": ["\n    ".join(textwrap.wrap(closer(records, AT_LENGTH[0], AS_ITS_SOURCE), 114))],
        "steps": [f"{STEPS:,}"],
        "most_steps": [f"{MOST_STEPS:,}"],
    }
    words = Template(WORDS.read_text(encoding="utf-8"))
    return words.substitute({name: "\n".join(lines) for name, lines in parts.items()})


if __name__ == "__main__":
    print(page(Records.read()), end="")
