"""The stage of points: kept on disk beside the front end's own, resumed, and absent in runs that were made without."""

import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.frontend.points_stage import find_points, load_points
from pipeline.frontend.structure_stage import load_structure, solve_structure
from tests.helpers.tubes.textured_tube import camera_at, render, stored


@pytest.fixture(scope="module")
def film():
    return [render(camera_at(k)) for k in range(24)]


@pytest.fixture
def solved(tmp_path, film):
    workspace, frames = stored(tmp_path, film)
    told = Config().front_end_settings
    return workspace, frames, solve_structure(frames, "odometry", told, workspace, SilentProgress())


def test_the_front_ends_points_stay_beside_the_new_ones(solved):
    workspace, frames, submaps = solved
    found = find_points(frames, submaps, 0.012, workspace, SilentProgress())
    np.testing.assert_array_equal(load_structure(workspace)[0].points, submaps[0].points)
    assert len(found[0].points) != len(submaps[0].points)
    assert np.median(found[0].depths()) == pytest.approx(1.0, rel=0.1)  # the unit stays
    assert workspace.result("points")["points"] == [len(found[0].points)]
    for again in (
        find_points(frames, submaps, 0.012, workspace, SilentProgress()),
        load_points(submaps, workspace),
    ):
        np.testing.assert_array_equal(again[0].points, found[0].points)
        np.testing.assert_array_equal(again[0].observations, found[0].observations)


def test_a_run_whose_depth_was_made_without_the_stage_keeps_its_points(solved):
    workspace, frames, submaps = solved
    workspace.finish("depth", keyframe_rows=[[0]])
    assert find_points(frames, submaps, 0.012, workspace, SilentProgress()) is submaps
    assert load_points(submaps, workspace) is submaps
    assert not workspace.is_done("points")


def test_depth_that_a_stopped_run_made_of_other_points_is_made_anew(solved):
    workspace, frames, submaps = solved
    workspace.depth.mkdir()
    (workspace.depth / "000000.png").write_bytes(b"of other points")
    find_points(frames, submaps, 0.012, workspace, SilentProgress())
    assert not workspace.depth.exists()


def test_a_damaged_file_is_named(solved):
    workspace, frames, submaps = solved
    find_points(frames, submaps, 0.012, workspace, SilentProgress())
    (workspace.log / "points" / "0" / "model.npz").write_bytes(b"cut off")
    with pytest.raises(HaustraError, match="points"):
        load_points(submaps, workspace)
