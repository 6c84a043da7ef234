"""Errors of points: medians by group beside NumPy's, and of points of a wall that is known; what a page counts."""

import numpy as np
import yaml
from hypothesis import given
from hypothesis import strategies as st

from benchmarks.common.rerun import FROM_DEPTH, FROM_SURFACE, without_surface
from benchmarks.points import _median_by, with_points
from pipeline.run_folder.workspace import open_workspace
from scripts.pages import points_page


@given(st.lists(st.tuples(st.integers(0, 9), st.floats(-5, 5) | st.just(float("nan"))), max_size=60))
def test_the_median_of_each_point_is_numpys(seen):
    point = np.array([p for p, _ in seen], np.int64)
    off = np.array([value for _, value in seen], np.float64)
    known = [off[(point == k) & np.isfinite(off)] for k in range(10)]
    expected = [np.median(values) if len(values) else np.nan for values in known]
    np.testing.assert_allclose(_median_by(point, off, 10), expected)


def test_both_front_ends_of_a_film_that_was_chosen_on_are_of_that_kind():
    assert points_page.kind("withdrawal_b, sfm") == points_page.kind("withdrawal_b") == "chosen on"
    assert points_page.kind("flexure, sfm") == "reported"


def test_a_copy_with_other_points_makes_all_later_stages_anew(tmp_path):
    with_points(_made(tmp_path), [], tmp_path / "own")
    assert not list((tmp_path / "own").rglob("*.png"))
    assert set(open_workspace(tmp_path / "own").record["stages"]) == {"frames", "lens", "structure", "points"}


def test_a_copy_with_another_surface_keeps_its_depth(tmp_path):
    without_surface(_made(tmp_path), tmp_path / "own")
    assert len(list((tmp_path / "own").rglob("*.png"))) == 2
    left = set(open_workspace(tmp_path / "own").record["stages"])
    assert {"depth", "refinement"} <= left
    assert not left & set(FROM_SURFACE)


def _made(tmp_path):
    """A finished run, as far as `rerun` looks at it."""

    class Made:
        folder, frames = tmp_path / "run", None

    for name in ("depth", "confidence"):
        (Made.folder / name).mkdir(parents=True)
        (Made.folder / name / "000000.png").write_bytes(b"of other points")
    stages = {stage: {} for stage in ("frames", "lens", "structure", "points", *FROM_DEPTH)}
    (Made.folder / "run.yaml").write_text(
        yaml.safe_dump({"stages": stages, "config": {}, "source": {"sha256": {"source": ""}}})
    )
    return Made
