"""Figures of the page on the paper's claims that are more than a mean: orders of rows, and means over all pixels."""

from dataclasses import asdict, replace

import numpy as np
import pytest

from benchmarks.paper.plan import IN_METRES, METRES, PAPER_STEPS, TRAININGS, Run, Training, tables
from benchmarks.paper.records import Records
from scripts.pages.paper.ablation import (
    closer,
    counted,
    in_published_order,
    order,
    order_cell,
    reductions,
    rows_of,
)
from scripts.pages.paper.in_words import higher_by, pooled, pooled_errors, seeds_with_pixels


def record(run, error, **frames):
    columns = {"mesh": [0, 0, 1, 1], **{name: [error] * 4 for name in ("abs_rel", "rmse", "mae", "delta_1")}} | frames
    about = asdict(run) | {"failed": None}
    del about["scenes"]
    return about | {"frames_digest": {"colon": ""}, "scenes": {"colon": {"frames": columns}}}


def records_of(training, errors):
    """A record of each row for each seed; errors: by seed, of baseline, +SA, +MSC and full."""
    return [
        record(Run(run.scenes, run.model, seed, run.steps, run.change), error)
        for seed, of in errors.items()
        for run, error in zip(training.runs("colon").values(), of, strict=True)
        if error is not None
    ]


def test_rows_are_ordered_over_the_seeds_that_all_have():
    first, in_metres = Training("early fusion"), Training("early fusion", change=METRES)
    made = records_of(first, {0: (0.4, 0.3, 0.2, 0.1), 1: (0.4, 0.3, None, 9.0)})
    made += records_of(in_metres, {0: (0.4, 0.3, 0.1, 0.2)})
    records = Records(made)
    assert order(records, "colon", first, "abs_rel") == ["full", "+MSC", "+SA", "baseline"]
    assert order(records, "colon", in_metres, "abs_rel") == ["+MSC", "full", "+SA", "baseline"]
    assert order(records, "colon", Training("early fusion", PAPER_STEPS), "abs_rel") == []
    assert in_published_order(records) == {"in_order": "1 of 2", "in_order_first": "1"}
    assert order_cell(records, "colon", first, "abs_rel") == "full < +MSC < +SA < baseline (1)"
    assert [line.split(" | ")[0] for line in rows_of(records, "colon", in_metres)] == [
        f"| early fusion, depth in metres: {row}" for row in ("baseline", "+SA", "+MSC", "full")
    ]


def test_every_training_has_a_label_of_its_own():
    labels = [training.label for training in TRAININGS["colon"]]
    assert len(set(labels)) == len(labels)
    assert labels[-1] == "early fusion, 15,660 steps, depth in metres, constant rate"


def test_means_over_pixels_are_those_of_all_pixels_at_once():
    rng = np.random.default_rng(0)
    run = Run(("colon",), "mscsa-early-fusion")
    misses, truths = zip(*((rng.normal(size=n), rng.uniform(5, 50, n)) for n in (10, 200, 30, 4)), strict=True)
    frames = {
        "pixels": [len(miss) for miss in misses],
        "abs_rel": [float(np.mean(np.abs(m) / t)) for m, t in zip(misses, truths, strict=True)],
        "rmse": [float(np.sqrt(np.mean(m**2))) for m in misses],
    }
    without = record(Run(("colon",), "mscsa-early-fusion", 1), 7.0)  # an older record, which has no pixels
    records = Records([record(run, 0.0, **frames), without])
    assert seeds_with_pixels(records, run) == {0}
    found = pooled_errors(records, run, {0})
    m, t = np.concatenate(misses), np.concatenate(truths)
    expected = (np.mean(frames["abs_rel"]), np.mean(np.abs(m) / t), np.mean(frames["rmse"]), np.sqrt(np.mean(m**2)))
    assert found == pytest.approx(expected)


def test_pixels_are_pooled_of_the_seeds_that_both_rows_have():
    rows = IN_METRES.runs("colon")
    pixels = {"pixels": [10, 20, 30, 40]}
    made = [record(replace(rows["full"], seed=seed), 0.1 * (1 + seed), **pixels) for seed in (0, 1)]
    made.append(record(replace(rows["baseline"], seed=1), 0.4, **pixels))
    assert pooled(Records(made)) == (
        "over all pixels, in metres, 1 seed: full below its baseline by abs.REL 50.0 % instead of 50.0 %, "
        "RMSE 50.0 % instead of 50.0 %"
    )
    assert pooled(Records(made[:2])) == "not measured"


def test_only_trainings_of_three_seeds_are_counted():
    first, in_metres = Training("early fusion"), Training("early fusion", change=METRES)
    made = records_of(first, dict.fromkeys(range(3), (0.4, 0.5, 0.2, 0.1)))
    made += records_of(in_metres, {0: (0.4, 0.3, 0.1, 0.2)})
    records = Records(made)
    assert counted(records, "full", "+MSC", "abs_rel") == "lower in 1 of 1 trainings and higher in 0"
    assert counted(records, "+SA", "baseline", "abs_rel") == "lower in 0 of 1 trainings and higher in 1"
    lines = reductions(records, "colon", [first, in_metres])
    assert "| abs.REL of full below baseline | 49.7 | 75.0 [75.0, 75.0] (3) | 50.0 [50.0, 50.0] (1) |" in lines
    assert closer(records, in_metres, first) == (
        "Closer to the paper's reduction with our unit and rate: abs.REL of full, RMSE of full, MAE of full; with the "
        "source's: abs.REL of +MSC, RMSE of +MSC, MAE of +MSC"
    )


def test_a_cost_says_its_seeds_unless_they_are_two():
    full = "mscsa-early-fusion"
    made = [record(Run(("colon",), full, seed), 0.2) for seed in range(3)]
    made += [record(Run(("colon",), full, seed, change=METRES), 0.3) for seed in range(3)]
    for one in made:
        one["environment"] = {"gpu": "a GPU"}
    changed = Run(("colon",), full, change=METRES)
    assert higher_by(Records(made), changed) == "50.0 [50.0, 50.0] % (three seeds)"
    assert higher_by(Records(made[:5]), changed) == "50.0 [50.0, 50.0] %"
    assert higher_by(Records(made[:4]), changed) == "50.0 [50.0, 50.0] % (one seed)"
    assert higher_by(Records(made[:3]), changed) == ""


def test_every_training_of_early_fusion_that_the_page_shows_is_in_the_queue():
    planned = {run for table in tables().values() for run in table.runs}
    shown = [training for training in TRAININGS["colon"] if training.body == "early fusion"]
    assert {run for training in shown for run in training.runs("colon").values()} <= planned
