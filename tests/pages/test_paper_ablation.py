"""Figures of the page on the paper's claims that are more than a mean: orders of rows, and means over all pixels."""

from dataclasses import asdict

import numpy as np
import pytest

from benchmarks.paper.plan import METRES, PAPER_STEPS, TRAININGS, Run, Training
from benchmarks.paper.records import Records
from scripts.pages.paper.ablation import in_published_order, order, rows_of
from scripts.pages.paper.in_words import pooled_errors


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
    assert in_published_order(records) == "1 of 2"
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
    found = pooled_errors(Records([record(run, 0.0, **frames), without]), run)
    m, t = np.concatenate(misses), np.concatenate(truths)
    expected = (np.mean(frames["abs_rel"]), np.mean(np.abs(m) / t), np.mean(frames["rmse"]), np.sqrt(np.mean(m**2)))
    assert found == pytest.approx(expected)
    assert pooled_errors(Records([without]), run) is None
