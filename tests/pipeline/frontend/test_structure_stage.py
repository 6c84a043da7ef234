"""`--front-end auto`: odometry, and COLMAP for clips of which odometry's result is doubtful."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config, OdometrySettings
from pipeline.frontend import automatic, scoring, second_opinion, structure_stage
from pipeline.frontend.automatic import FrontEndJob, run_front_ends
from pipeline.frontend.base import FrontEndResult
from pipeline.frontend.colmap import front_end as colmap
from pipeline.frontend.registry import FRONT_ENDS, check_front_end
from pipeline.frontend.scoring import Candidate, best_mapper
from pipeline.matching.sift_cache import SiftCache
from tests.helpers.candidates import DARK, GOOD, many_frames, map_of
from tests.helpers.tubes.textured_tube import CAMERA

SETTINGS = Config().front_end_settings
NO_FEATURES = SiftCache(None)  # nobody asks for any


@pytest.fixture
def asked(monkeypatch, tmp_path):
    """Run the stage's front ends with mappers that find what is given; the mappers run, in order, and the best one."""

    def call(front_end, frames, found):
        ran = []

        def look_up(mapper):
            ran.append(mapper)
            return mapper

        monkeypatch.setattr(colmap, "run_isolated", lambda *_: None)
        monkeypatch.setattr(colmap, "colmap_job", lambda *_: {})
        monkeypatch.setattr(colmap, "map_by_colmap", lambda mapper, *_: [look_up(mapper)])
        monkeypatch.setattr(automatic, "with_doubts", lambda found, *_: found)
        for module in (colmap, automatic):
            monkeypatch.setattr(module, "candidates_of", lambda mapper, *_: found[mapper])
        odometry = SimpleNamespace(run=lambda *_: FrontEndResult({"odometry": [look_up("odometry")]}))
        monkeypatch.setitem(FRONT_ENDS, "odometry", odometry)
        many = many_frames(frames)
        workspace = SimpleNamespace(log=tmp_path, record={})
        results, failure = run_front_ends(
            FrontEndJob(NO_FEATURES, SETTINGS, workspace, SilentProgress()), front_end, many
        )
        assert failure is None
        mapped = {mapper: of for result in results.values() for mapper, of in result.candidates.items()}
        assert list(mapped) == ran
        return ran, best_mapper(mapped, frames)

    return call


def test_a_good_map_of_odometry_is_enough(asked):
    assert asked("auto", 100, {"odometry": [GOOD]}) == (["odometry"], "odometry")


def test_colmap_is_asked_where_odometry_is_doubtful(asked):
    assert asked("auto", 100, {"odometry": [DARK], "global": [GOOD]}) == (["odometry", "global"], "global")
    found = {"odometry": [], "global": [], "incremental": [GOOD]}
    assert asked("auto", 100, found) == (["odometry", "global", "incremental"], "incremental")


def test_colmap_is_asked_where_odometrys_map_may_well_be_wrong_and_its_own_wins_by_the_probability(asked):
    def doubted(probability):
        return replace(GOOD, doubt=SimpleNamespace(probability=probability))

    assert asked("auto", 100, {"odometry": [doubted(0.19)]}) == (["odometry"], "odometry")
    assert asked("auto", 100, {"odometry": [doubted(0.51)], "global": [GOOD]}) == (["odometry", "global"], "global")
    found = {"odometry": [doubted(0.51)], "global": [map_of(range(60), mapper="global")], "incremental": []}
    assert asked("auto", 100, found)[1] == "odometry", "0.49 of a whole map is worth more than 60 % of one"
    found["odometry"] = [doubted(0.8)]
    assert asked("auto", 100, found)[1] == "global"


def test_colmap_is_not_asked_of_a_long_video(asked):
    long = second_opinion.MOST_EVERY * second_opinion.MOST_FRAMES + 10
    assert asked("auto", long, {"odometry": [DARK]}) == (["odometry"], "odometry")


def test_a_mapper_that_finds_nothing_does_not_win(asked):
    assert asked("auto", 100, {"odometry": [DARK], "global": [], "incremental": []})[1] == "odometry"


def test_sfm_and_odometry_ask_nobody_else(asked):
    assert asked("sfm", 100, {"global": [DARK], "incremental": []})[0] == ["global", "incremental"]
    assert asked("odometry", 100, {"odometry": []})[0] == ["odometry"]


def test_who_asks_for_sfm_gets_sfm(asked):
    assert asked("sfm", 100, {"global": [], "incremental": [DARK]})[0] == ["global", "incremental"]
    long = second_opinion.MOST_EVERY * second_opinion.MOST_FRAMES + 10
    assert asked("sfm", long, {"global": [], "incremental": []})[0][0] == "global"


def test_auto_survives_a_matcher_that_fails(monkeypatch, tmp_path):
    def fail(*_):
        raise HaustraError("features and matches failed")

    def call(front_end):
        monkeypatch.setattr(colmap, "run_isolated", fail)
        monkeypatch.setattr(colmap, "colmap_job", lambda *_: {})
        monkeypatch.setattr(automatic, "candidates_of", lambda *_: [DARK])
        monkeypatch.setattr(automatic, "with_doubts", lambda found, *_: found)
        found = SimpleNamespace(run=lambda *_: FrontEndResult({"odometry": []}))
        monkeypatch.setitem(FRONT_ENDS, "odometry", found)
        few = many_frames(100)
        workspace = SimpleNamespace(log=tmp_path, record={})
        return run_front_ends(FrontEndJob(NO_FEATURES, SETTINGS, workspace, SilentProgress()), front_end, few)

    results, failure = call("auto")
    assert list(results) == ["odometry"]
    assert "failed" in failure
    with pytest.raises(HaustraError, match="failed"):
        call("sfm")


def test_both_mappers_crashing_names_their_logs(monkeypatch, tmp_path):
    def crash(*words):
        if words[1] == "map":
            raise HaustraError("crashed")

    monkeypatch.setattr(colmap, "run_isolated", crash)
    monkeypatch.setattr(colmap, "colmap_job", lambda *_: {})
    frames, workspace = many_frames(30), SimpleNamespace(log=tmp_path, record={})
    with pytest.raises(HaustraError, match=f"logs are in {tmp_path}"):
        FRONT_ENDS["sfm"].run(frames, NO_FEATURES, SETTINGS, workspace, SilentProgress())
    found = SimpleNamespace(run=lambda *_: FrontEndResult({"odometry": []}))
    monkeypatch.setitem(FRONT_ENDS, "odometry", found)
    with pytest.raises(
        HaustraError, match=f"30 frames tried by odometry.*; sfm failed as well: .*logs are in {tmp_path}"
    ):
        structure_stage._solve(frames, NO_FEATURES, "auto", SETTINGS, workspace, SilentProgress())


@pytest.mark.parametrize(
    ("light", "probability", "stays"),
    [(0.0, 0.9, True), (0.06, 0.6, True), (0.06, 0.9, True), (0.06, None, False), (0.0, None, True)],
)
def test_a_smaller_submap_goes_where_the_light_contradicts_it_and_no_probability_is_known(light, probability, stays):
    other, doubt = map_of(range(30), light), None if probability is None else SimpleNamespace(probability=probability)
    other = replace(other, doubt=doubt)
    assert scoring.accepted([GOOD, other]) == ([GOOD, other] if stays else [GOOD])
    assert scoring.accepted([other]) == [other], "the largest always stays"


@pytest.mark.parametrize(
    ("given", "factor", "origin"), [(True, 1.0, "given"), (False, 1.0, "guessed"), (False, 1.1, "refined by the film")]
)
def test_a_kept_lens_says_where_it_is_from(monkeypatch, given, factor, origin):
    told = []
    monkeypatch.setattr(structure_stage, "write_lens", lambda *of: told.append(of))
    began = replace(CAMERA, trusted=given)
    ended = replace(began, params=(factor * CAMERA.params[0], *CAMERA.params[1:]))
    structure_stage._keep_lens(began, ended, None)
    assert told == [(ended, origin, None)]


def test_only_long_submaps_of_mappers_with_coefficients_are_given_a_probability(monkeypatch):
    monkeypatch.setattr(scoring, "refined_camera", lambda *_: None)
    monkeypatch.setattr(scoring, "gather_evidence", lambda *_, predictors: "evidence")
    by_family = {"odometry": SimpleNamespace(probability=0.9), "colmap": SimpleNamespace(probability=0.1)}
    monkeypatch.setattr(scoring, "judge", lambda evidence, family: by_family[family])
    short = Candidate(SimpleNamespace(frames=np.arange(scoring.MIN_JUDGED - 1)), GOOD.check, Path(), "odometry")
    kept, frames = [GOOD, short], many_frames(100)
    monkeypatch.setattr(scoring, "coefficients", lambda: {"odometry": {"weights": {}}})
    found = scoring.with_doubts([*kept, replace(GOOD, mapper="global"), replace(GOOD, mapper="poses")], frames)
    assert [one.doubt for one in found] == [by_family["odometry"], None, None, None]
    monkeypatch.setattr(scoring, "coefficients", lambda: {"colmap": {"weights": {}}})
    assert scoring.with_doubts([replace(GOOD, mapper="global")], frames)[0].doubt == by_family["colmap"]


def test_a_map_that_cannot_be_judged_is_as_probably_wrong_as_those_of_its_film_that_can(monkeypatch):
    """Two long maps of 60 and 20 frames, wrong with 90 and 10 %."""
    probability = {60: 0.9, 20: 0.1}

    def judged(one, *_):
        doubt = probability.get(one.check.frames)
        return replace(one, doubt=None if doubt is None else SimpleNamespace(probability=doubt))

    monkeypatch.setattr(scoring, "with_doubt", judged)
    maps, frames = [map_of(range(60)), map_of(range(60, 80)), map_of(range(80, 90))], many_frames(100)
    assert [one.wrong_probability for one in scoring.with_doubts(maps, frames)] == pytest.approx([0.9, 0.1, 0.7])
    assert scoring.mean_doubt(scoring.with_doubts(maps, frames)) == pytest.approx(0.7)
    alone = maps[2:]
    assert [one.wrong_probability for one in scoring.with_doubts(alone, frames, 0.6)] == [0.6]
    assert [one.wrong_probability for one in scoring.with_doubts(alone, frames)] == [scoring.WRONG_OF_UNKNOWN]


def test_choices_that_cannot_work_are_refused_at_once():
    with pytest.raises(HaustraError, match=r"no front end 'orb'; known: auto, odometry, sfm"):
        check_front_end("orb", SETTINGS)
    fast = Config(odometry=OdometrySettings(keyframe_motion=0.05)).front_end_settings
    with pytest.raises(HaustraError, match="no keyframe_motion"):
        check_front_end("sfm", fast)
    check_front_end("auto", fast)


@pytest.mark.parametrize("given", [True, False])
def test_a_guess_that_nothing_asked_is_not_called_undetermined_by_motion(given):
    submap = SimpleNamespace(camera_params=CAMERA.params, camera_sigma=())
    said = structure_stage.camera_trust(CAMERA, submap, given)
    assert ("no trusted map determines it" in said) != given
    assert ("do not trust shapes and lengths" in said) == given
    assert said.startswith(
        f"camera: focal length guessed as {CAMERA.focal[0]:.1f} px for working frames {CAMERA.width} px wide, and "
    )


def test_a_focal_length_that_a_film_leaves_open_is_said_without_a_number():
    said = structure_stage.camera_trust(
        CAMERA, SimpleNamespace(camera_params=CAMERA.params, camera_sigma=(4e4,)), False
    )
    assert said.endswith("and kept; this film does not determine it at all: shapes may be stretched along the view")


def test_a_refined_focal_length_is_said_beside_its_guess():
    submap = SimpleNamespace(camera_params=(CAMERA.params[0] + 2, *CAMERA.params[1:]), camera_sigma=(0.5,))
    said = structure_stage.camera_trust(CAMERA, submap, False)
    assert f" px wide, {CAMERA.focal[0] + 2:.1f} px after adjustment (sigma 0.5 px for 1 px of noise)" in said
