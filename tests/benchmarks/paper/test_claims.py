"""The paper's numbers as its sentences state them, and what an interval says of a claim."""

from dataclasses import asdict

import numpy as np
import pytest

from benchmarks.paper.claims import Reduction, claims, finding, lead_in_delta, verdict
from benchmarks.paper.intervals import Interval
from benchmarks.paper.judgements import (
    best_rival_in_colon,
    colon_is_easiest,
    delta_1_on,
    larger_in_small_intestine,
    leads_in_delta_1,
    reductions_below,
)
from benchmarks.paper.judgements_figures import (
    abnormal_in_small_intestine,
    gain_of_features,
    growth_with_features,
    steeper_for_uniform,
)
from benchmarks.paper.plan import BODIES, FIGURE_5, MOST_STEPS, OURS, POINT_COUNTS, RIVALS, SCENES, Run, Training
from benchmarks.paper.published import TABLE_1, TABLE_2, reduction
from benchmarks.paper.records import Records

STATED = [  # section III-D: scene, row, beside, figure, percent
    ("colon", "full", "baseline", "abs_rel", 49.7),
    ("small_intestine", "full", "baseline", "abs_rel", 70.8),
    ("colon", "+MSC", "baseline", "rmse", 30.1),
    ("small_intestine", "+MSC", "baseline", "rmse", 54.4),
    ("colon", "+SA", "baseline", "abs_rel", 11.0),
    ("colon", "full", "+MSC", "abs_rel", 26.9),
    ("small_intestine", "full", "+MSC", "abs_rel", 13.2),
]


@pytest.mark.parametrize(("scene", "row", "beside", "figure", "percent"), STATED)
def test_table_2_gives_what_the_text_says(scene, row, beside, figure, percent):
    assert round(100 * reduction(scene, row, beside, figure), 1) == percent


def test_three_sentences_differ_from_the_tables_that_they_speak_of():
    """38.7 % is the MAE of the colon, 49.6 % is 48.0, and the lead in delta 1 is never 0.03."""
    assert round(100 * reduction("small_intestine", "+MSC", "baseline", "mae"), 1) == 66.2
    assert round(100 * reduction("colon", "+MSC", "baseline", "mae"), 1) == 38.7
    below = 1 - TABLE_1["colon"]["MSCSA-Net"]["mae"] / TABLE_1["colon"]["StD-ResNet50"]["mae"]
    assert round(100 * below, 1) == 48.0
    leads = [lead_in_delta(scene) for scene in TABLE_1]
    assert max(leads) < 0.03
    assert np.mean(leads) == pytest.approx(0.011, abs=5e-4)


def test_full_is_the_same_row_in_both_tables():
    for scene in TABLE_2:
        assert TABLE_2[scene]["full"] == TABLE_1[scene]["MSCSA-Net"]


@pytest.mark.parametrize(
    ("low", "high", "claimed", "word"),
    [
        (0.3, 0.5, 0.497, "reproduced"),
        (0.6, 0.7, 0.497, "in sign, larger"),
        (0.1, 0.4, 0.497, "in sign, smaller"),
        (-0.1, 0.2, 0.11, "not decided"),
        (-0.3, -0.1, 0.11, "not reproduced"),
        (-0.3, 0.05, 0.11, "not reproduced"),  # if there is anything, it is less than half of the claim
        (-0.2, -0.05, -0.06, "reproduced"),  # a row that is claimed to be worse, and is
        (0.05, 0.2, -0.06, "not reproduced"),
    ],
)
def test_verdicts_follow_the_interval(low, high, claimed, word):
    assert verdict((Interval((low + high) / 2, low, high), 3), claimed) == f"{word}, 3 seeds"
    assert verdict(None, claimed) == "not measured"


@pytest.mark.parametrize(
    ("low", "high", "claimed", "word"),
    [
        (0.6, 0.7, 0.497, "in sign"),
        (-0.1, 0.2, 0.11, "not decided"),
        (-0.3, -0.1, 0.11, "not in sign"),
        (-0.2, -0.05, -0.06, "in sign"),
    ],
)
def test_of_one_seed_the_sign_alone_is_judged(low, high, claimed, word):
    assert verdict((Interval((low + high) / 2, low, high), 1), claimed) == f"{word}, 1 seed"


def record(model, seed, abs_rel, **about):
    meshes = [0, 0, 1, 1]
    frames = {"mesh": meshes, "abs_rel": abs_rel, "rmse": abs_rel, "mae": abs_rel, "delta_1": abs_rel}
    run = asdict(Run(("colon",), model, seed)) | {"failed": None} | about
    digests = dict.fromkeys(run.pop("scenes") if "digests" not in about else about["digests"], "")
    return run | {"frames_digest": digests, "scenes": {scene: {"frames": frames} for scene in digests}}


def test_a_reduction_is_taken_over_the_seeds_that_both_rows_have():
    models = BODIES["early fusion"]
    baseline, full = record(models[0], 0, [0.2, 0.2, 0.4, 0.4]), record(models[3], 0, [0.1, 0.1, 0.2, 0.2])
    other = record(models[3], 0, [7.0, 7.0, 7.0, 7.0], points=1000)  # of Figure 5
    failed = record(models[3], 2, [7.0, 7.0, 7.0, 7.0], failed="no pixel")
    records = Records([baseline, full, other, failed, record(models[3], 1, [9.0, 9.0, 9.0, 9.0])])
    found = finding(records, Reduction("colon", "full", "baseline", "abs_rel"), Training("early fusion"))
    assert found is not None
    assert (found[0].value, found[0].low, found[0].high, found[1]) == pytest.approx((0.5, 0.5, 0.5, 1))
    assert finding(records, Reduction("colon", "+SA", "baseline", "abs_rel"), Training("early fusion")) is None
    assert records.failed(Run(("colon",), models[3])) == 1


def test_every_comparison_is_of_rows_that_exist():
    for claim in claims():
        for of in claim.compared:
            assert {of.row, of.beside} <= set(TABLE_2[of.scene])


def table_1(values):
    """A record for each network, one error on every frame: abs.REL, and delta 1 by 1 less that."""
    records = []
    for model, error in values.items():
        scenes = {"digests": tuple(SCENES), "steps": MOST_STEPS, "converged": True}
        made = record(model, 0, [error] * 4, **scenes)
        for of in made["scenes"].values():
            of["frames"] = of["frames"] | {"delta_1": [1 - error] * 4}
        records.append(made)
    return Records(records)


def test_sentences_on_several_networks_follow_their_means():
    of = dict(zip((*OURS, *RIVALS), (0.02, 0.02, 0.02, 0.02, 0.08, 0.09, 0.07, 0.1), strict=True))
    found = best_rival_in_colon(table_1(of))
    assert found is not None
    assert found[1] == "reproduced"
    assert "GAENet 7.0 %" in found[0]
    assert best_rival_in_colon(table_1(of | {"nlspn": 0.01}))[1] == "not reproduced"
    del of["gaenet"]
    assert best_rival_in_colon(table_1(of)) is None
    of |= {"gaenet": 0.07}
    assert leads_in_delta_1(0.03, mean=False)(table_1(of))[1] == "reproduced"
    assert leads_in_delta_1(0.06, mean=True)(table_1(of))[1] == "in sign, smaller"
    assert "0.0500 [0.0500, 0.0500]" in leads_in_delta_1(0.03, mean=False)(table_1(of))[0]
    told = "that it is behind: reproduced; values of other data"
    assert delta_1_on("ccd", ("gaenet", "mscsa-plain"))(table_1(of))[1] == told
    assert (
        larger_in_small_intestine("std50")(table_1(of))[1] == "RMSE not decided, abs.REL not decided, MAE not decided"
    )
    assert reductions_below("colon", "std50")(table_1(of))[0].startswith("RMSE 77.8 [77.8, 77.8] %")
    of_scenes = table_1(of)
    for made in of_scenes.records:
        for scene, judged in made["scenes"].items():
            worse = 0.0 if scene == "colon" else 0.01
            for figure in ("rmse", "abs_rel"):
                judged["frames"][figure] = [value + worse for value in judged["frames"][figure]]
    assert colon_is_easiest(of_scenes)[1] == "reproduced"
    assert larger_in_small_intestine("std50")(of_scenes)[1].startswith("RMSE not reproduced")  # both have a point more
    of_scenes.records[3]["scenes"]["csd"]["frames"]["rmse"] = [0.0] * 4
    assert colon_is_easiest(of_scenes)[1] == "not reproduced"


def figure_5(values):
    """abs.REL by number of points and sampler; delta 1 by 1 less that."""
    records = []
    for (count, sampler), error in values.items():
        made = record(FIGURE_5, 0, [error] * 4, points=count, sampler=sampler)
        made["scenes"]["colon"]["frames"] = made["scenes"]["colon"]["frames"] | {"delta_1": [1 - error] * 4}
        records.append(made)
    return Records(records)


def test_sentences_on_numbers_of_points_follow_the_records():
    errors = dict(zip(POINT_COUNTS, (0.2, 0.1, 0.05, 0.04), strict=True))
    uniform = {(count, "uniform"): error for count, error in errors.items()}
    features = {(count, "features"): error + 0.1 / (1 + count) for count, error in errors.items()}
    told = steeper_for_uniform(figure_5(uniform | features))
    assert told is not None
    assert told[1] == "it rises, but for features more"
    assert steeper_for_uniform(figure_5(uniform)) is None
    flat = {(count, "features"): 0.1 - 0.001 * k for k, count in enumerate(POINT_COUNTS)}
    assert steeper_for_uniform(figure_5(uniform | flat))[1] == "reproduced"
    assert steeper_for_uniform(figure_5(uniform | {(c, "features"): 0.1 for c in (10, 100, 1000)})) is None
    worse = gain_of_features((10, 100))(figure_5(uniform | {k: 2 * v for k, v in features.items()}))
    assert worse is not None
    assert worse[1] == "they lose"
    better = gain_of_features((10, 100))(figure_5(uniform | {k: v / 2 for k, v in features.items()}))
    assert better is not None
    assert better[1] == "they gain"
    assert growth_with_features(figure_5(uniform | features))[1] == "not reproduced"
    assert growth_with_features(figure_5(uniform | flat))[1] == "reproduced"
    assert growth_with_features(figure_5(uniform)) is None


def test_frames_that_fail_are_counted_beside_ours_and_beside_the_colon():
    records = table_1(dict.fromkeys((*OURS, *RIVALS), 0.1))
    assert "0 of 3 fail more often than ours, and 0 than in the colon" in abnormal_in_small_intestine(records)[1]
    for made in records.records:
        if made["model"] in RIVALS:
            made["scenes"]["small_intestine"]["frames"]["abs_rel"] = [0.3, 0.3, 0.3, 0.1]
    text, finding = abnormal_in_small_intestine(records)
    assert finding == "reproduced"
    assert "GAENet 75.0 % (0.0 %), NLSPN 75.0 % (0.0 %), MSCSA-Net, plain U-Net 0.0 % (0.0 %)" in text
    assert abnormal_in_small_intestine(Records(records.records[:-1])) is None
