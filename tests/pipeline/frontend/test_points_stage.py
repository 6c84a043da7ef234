"""The stage of points: kept on disk beside the front end's own, resumed, and absent in runs that were made without."""

from collections import Counter

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline import run
from pipeline.config import Config, FrameSettings
from pipeline.demo import CAMERA, VIDEO
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.points_stage import find_points, load_points
from pipeline.frontend.structure_stage import load_structure, solve_structure
from pipeline.matching import sift_cache
from tests.helpers.tubes.textured_tube import camera_at, render, stored


@pytest.fixture(scope="module")
def film():
    return [render(camera_at(k)) for k in range(24)]


@pytest.fixture
def solved(tmp_path, film):
    workspace, frames = stored(tmp_path, film)
    with frame_features(workspace) as features:  # what was begun ends here
        return workspace, frames, solved_by(features, workspace, frames)


def solved_by(features, workspace, frames):
    told = Config().front_end_settings
    return solve_structure(frames, features, "odometry", told, workspace, SilentProgress())


def found_by(workspace, frames, submaps, features=None):
    features = features or frame_features(workspace)
    return find_points(frames, features, submaps, 0.012, workspace, SilentProgress())


def test_the_front_ends_points_stay_beside_the_new_ones(solved):
    workspace, frames, submaps = solved
    found = found_by(workspace, frames, submaps)
    np.testing.assert_array_equal(load_structure(workspace)[0].points, submaps[0].points)
    assert len(found[0].points) != len(submaps[0].points)
    assert np.median(found[0].depths()) == pytest.approx(1.0, rel=0.1)  # the unit stays
    assert workspace.result("points")["points"] == [len(found[0].points)]
    (turned,) = workspace.result("points")["turned_deg"]
    assert 0 < turned < 1
    assert not np.array_equal(found[0].world_from_camera, submaps[0].world_from_camera)
    np.testing.assert_array_equal(load_structure(workspace)[0].world_from_camera, submaps[0].world_from_camera)
    for again in (found_by(workspace, frames, submaps), load_points(submaps, workspace)):
        np.testing.assert_array_equal(again[0].points, found[0].points)
        np.testing.assert_array_equal(again[0].observations, found[0].observations)


def test_features_of_the_front_end_are_not_found_again(tmp_path, film, solved, monkeypatch):
    (tmp_path / "shared").mkdir()
    workspace, frames = stored(tmp_path / "shared", film)
    found, detect = Counter(), sift_cache.detect_sift

    def counting(rgb, mask):
        found[rgb.tobytes()] += 1
        return detect(rgb, mask)

    monkeypatch.setattr(sift_cache, "detect_sift", counting)
    with frame_features(workspace) as features:
        submaps = solved_by(features, workspace, frames)
        of_front_end = len(found)
        shared = found_by(workspace, frames, submaps, features)
    assert of_front_end > 0
    assert set(found.values()) == {1}
    alone = found_by(*solved)
    np.testing.assert_array_equal(shared[0].points, alone[0].points)


def test_a_run_hands_both_stages_the_same_features(tmp_path, monkeypatch):
    handed = []

    def solve(frames, features, *_):
        handed.append(features)
        return []

    def find(frames, features, *_):
        handed.append(features)
        raise InterruptedError

    monkeypatch.setattr(run, "solve_structure", solve)
    monkeypatch.setattr(run, "find_points", find)
    config = Config(camera=str(CAMERA), frames=FrameSettings(end_s=0.3))
    with pytest.raises(InterruptedError):
        run.reconstruct(VIDEO, tmp_path / "run", config)
    assert handed[0] is handed[1]


def test_a_run_whose_depth_was_made_without_the_stage_keeps_its_points(solved):
    workspace, frames, submaps = solved
    workspace.finish("depth", keyframe_rows=[[0]])
    assert found_by(workspace, frames, submaps) is submaps
    assert load_points(submaps, workspace) is submaps
    assert not workspace.is_done("points")


def test_depth_that_a_stopped_run_made_of_other_points_is_made_anew(solved):
    workspace, frames, submaps = solved
    workspace.depth.mkdir()
    (workspace.depth / "000000.png").write_bytes(b"of other points")
    found_by(workspace, frames, submaps)
    assert not workspace.depth.exists()


def test_a_damaged_file_is_named(solved):
    workspace, frames, submaps = solved
    found_by(workspace, frames, submaps)
    (workspace.log / "points" / "0" / "model.npz").write_bytes(b"cut off")
    with pytest.raises(HaustraError, match="points"):
        load_points(submaps, workspace)
