"""Coverage where the way itself is hard: limbs of a loop that touch, gaps in the poses, regions that go all round."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.finished_run import summary
from pipeline.report.page.summary import coverage_section
from pipeline.run_folder.workspace import Workspace
from pipeline.surface import coverage_stage as stage
from pipeline.surface.coverage_stage import CoverageResult, likely, share_seen
from reconstruction.coverage.centreline import NotATube, WallRays, lumen_radius, trace_centreline
from reconstruction.coverage.coverage import measure_coverage
from reconstruction.coverage.coverage_figure import draw_coverage
from reconstruction.coverage.hole_closing import ClosedWall
from reconstruction.coverage.unrolled_map import MISSED, NOT_JUDGED, SEEN, unroll
from reconstruction.mesh.surface_mesh import SurfaceMesh
from tests.helpers.tubes.holed_tube import RADIUS, cameras, patch, straight, tube


def omega():
    """The middle line of a loop whose limbs come within 44 mm, 4 mm between the walls; its length. Bends are 50 and
    70 mm wide, so that the tube is smooth."""

    def arc(centre, radius, start, end):
        angle = np.radians(np.linspace(start, end, 400))[1:]
        return centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])

    half = [arc((0, 0), 70, 90, -53.13), arc((72, -96), 50, 126.87, 270), np.array([[72 + 80, -146]])]
    right = np.concatenate(half)
    flat = np.concatenate([right[::-1] * (-1, 1), [[0, 70]], right])
    at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(flat, axis=0), axis=1))])
    even = np.arange(0, at[-1], 1.0)
    points = np.column_stack([np.interp(even, at, flat[:, 0]), 0 * even, np.interp(even, at, flat[:, 1])])
    slope = np.gradient(points, axis=0)

    def middle(s):
        place, tangent = (
            np.stack([np.interp(s, even, values[:, k]) for k in range(3)], -1) for values in (points, slope)
        )
        return place, tangent / np.linalg.norm(tangent, axis=-1, keepdims=True), np.zeros_like(place) - [0, 1, 0]

    return middle, float(even[-1])


@pytest.fixture(scope="module")
def loop():
    middle, length = omega()
    poses = cameras(middle, start=10.0, end=length - 30, count=int(length / 3), off=0.0)
    return tube(middle, length=length), poses, length


def test_the_line_does_not_jump_between_limbs_that_touch(loop):
    mesh, poses, length = loop
    line = trace_centreline(mesh, poses, lumen_radius(WallRays(mesh), poses))
    off = [np.linalg.norm(line.points - centre, axis=1).min() for centre in poses[:, :3, 3]]
    assert max(off) < 0.2 * RADIUS
    assert line.arc[-1] > length - 40  # what the cameras travelled
    coverage = measure_coverage(mesh, poses)
    assert coverage.length == pytest.approx(length - 40, abs=5)
    assert coverage.share > 0.99


def test_a_line_that_leaves_cameras_aside_is_refused():
    """The camera also goes out sideways through an opening, as into another lumen: one line cannot judge both."""
    mesh, poses = tube(straight, patch(45, 75, 45, 135), length=160.0), cameras(straight, end=130.0)
    aside = poses[:15].copy()
    aside[:, :3, 3] = [0, 0, 60] + np.linspace(5, 90, 15)[:, None] * [1, 0, 0]
    with pytest.raises(NotATube, match=r"leaves 2. % of the camera's way aside"):
        measure_coverage(mesh, np.concatenate([poses, aside]))


def test_what_no_posed_frame_passed_is_not_judged():
    """Poses are missing over 60 mm of a lumen of 200, and so is a ring of wall there."""
    mesh = tube(straight, patch(90, 110, -1, 361), length=200.0)
    poses = np.concatenate([cameras(straight, 10, 50, 15), cameras(straight, 110, 160, 20)])
    coverage = measure_coverage(mesh, poses)
    np.testing.assert_allclose(coverage.visited, [(0, 40), (100, 150)], atol=2)
    assert coverage.length == pytest.approx(90, abs=3)
    assert coverage.share > 0.999
    assert coverage.regions == []
    starts = [segment.start for segment in coverage.segments(25.0)]
    np.testing.assert_allclose(starts, [0, 25, 100, 125], atol=2)
    unrolled_map = unroll(coverage, mesh)
    middle = (unrolled_map.arc_edges[1:] + unrolled_map.arc_edges[:-1]) / 2
    assert (unrolled_map.state[(middle > 42) & (middle < 98)] == NOT_JUDGED).all()
    assert (unrolled_map.state[(middle > 104) & (middle < 146)] == SEEN).all()
    assert unrolled_map.arc_edges[-1] > 150


def test_a_ring_has_no_hour(tmp_path):
    mesh = tube(straight, patch(55, 65, -1, 361))
    coverage = measure_coverage(mesh, cameras(straight))
    (region,) = [r for r in coverage.regions if r.diameter > 5]
    assert region.clock is None
    draw_coverage(coverage, unroll(coverage, mesh, 1), coverage.segments(50), 1, tmp_path / "coverage.png")
    row = {"number": 1, "area": 50, "diameter": 8, "arc": 3, "clock": region.clock, "frame": 7, "seconds": 0.2}
    record = {"judged": True, "unit": "mm", "covered_percent": 90.0, "stretch": 80.0, "listed_from": 5.0}
    record |= {"smaller_regions": 4, "missed_regions": [row]}
    assert "<td>all round</td>" in coverage_section(CoverageResult(record, tmp_path / "coverage.png"), {})


def test_a_listed_region_shows_on_the_map_even_beneath_a_fold():
    """Unseen wall in front of seen wall, which has more area: no cell is missed by half."""
    mesh = tube(straight)
    coverage = measure_coverage(mesh, cameras(straight))
    flank = tube(straight, lambda s, a: ~patch(60, 70, 60, 120)(s, a), radius=lambda s, a: RADIUS - 10 + 0 * s)
    seen, count = coverage.closed_wall, len(flank.faces)
    arc, angle, _ = coverage.line.locate(flank.vertices[flank.faces].mean(axis=1))
    closed_wall = ClosedWall(
        np.concatenate([seen.vertices, flank.vertices]),
        np.concatenate([seen.faces, flank.faces + len(seen.vertices)]),
        np.append(seen.unobserved, np.ones(count, bool)),
        np.append(seen.arc, arc),
        np.append(seen.angle, angle),
        np.zeros(len(seen.faces) + count, bool),
        np.append(seen.distance, np.full(count, 10.0)),
    )
    hidden = replace(coverage, closed_wall=closed_wall, region=np.append(coverage.region, np.zeros(count, int)))
    assert (unroll(hidden, mesh).state != MISSED).all()
    unrolled_map = unroll(hidden, mesh, listed=1)
    rows, columns = np.nonzero(unrolled_map.state == MISSED)
    assert len(rows) > 100
    assert set(unrolled_map.region[rows, columns]) == {0}
    assert np.degrees(unrolled_map.angle_edges[columns]).mean() == pytest.approx(90, abs=5)


def test_the_headline_names_the_submap_that_it_speaks_of(tmp_path):
    seen = {"judged": True, "covered_percent": 90.0, "stretch": 80.0, "unit": "mm"}
    one = {"coverage": seen, "keyframes": 3, "faces": 5, "area": 2.0, "unit": "mm", "camera": {"trust": "given"}}
    one["frames"] = 4
    metrics = {"frames": {"posed": 5, "total": 9}, "submaps": [one], "warnings": []}
    assert summary(metrics, tmp_path).startswith("5 of 9 frames posed, 3 keyframes, ")
    assert "of 1 submaps" not in summary(metrics, tmp_path)
    metrics["submaps"] = [one, one, one]
    assert summary(metrics, tmp_path).startswith(
        "5 of 9 frames posed in 3 submaps; the largest: 4 frames, 3 keyframes, "
    )
    assert "90 % of the wall along 80 mm of visited lumen was seen in the largest of 3 submaps" in summary(
        metrics, tmp_path
    )


def test_the_share_seen_is_said_with_its_error_and_regions_with_how_many_are_likely():
    seen = {"judged": True, "covered_percent": 90.04, "covered_error_points": 3.4}
    assert (share_seen(seen), share_seen(seen, 1)) == ("90 ± 3 %", "90.0 ± 3.4 %")
    assert share_seen({"covered_percent": 90.04}) == "90 %"  # a run of before
    regions = [{"probability": 0.9}, {"probability": 0.51}, {"probability": 0.5}]
    assert likely(regions) == " (2 of them more likely hidden than not)"
    assert likely([]) == likely([{"diameter": 7.0}]) == ""


def test_three_cautions_are_said_with_success_and_the_others_are_counted(tmp_path):
    seen = {"judged": True, "covered_percent": 90.0, "stretch": 80.0, "unit": "mm"}
    one = {"coverage": seen, "keyframes": 3, "faces": 5, "area": 2.0, "unit": "mm", "camera": {"trust": "given"}}
    one["frames"] = 4
    warnings = ["the lens may be another endoscope's", "points miss a still wall", "do not trust the millimetres"]
    metrics = {"frames": {"posed": 5, "total": 9}, "submaps": [one, one], "warnings": warnings}
    assert summary(metrics, tmp_path).endswith("; CAUTION: " + "; ".join(warnings))
    metrics["warnings"] = [*warnings, "and one more"]
    assert summary(metrics, tmp_path).endswith("; do not trust the millimetres; 1 more on the report")


def test_a_finished_stage_is_loaded_and_not_measured_again(tmp_path, monkeypatch):
    workspace = Workspace(tmp_path)
    workspace.log.mkdir()
    patch = SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]])
    record = {"judged": True, "covered_percent": np.float64(81.25), "visited": [(0.0, np.float64(2.5))]}
    results = [
        CoverageResult(record, tmp_path / "coverage.png", (patch, patch)),
        CoverageResult({"judged": False}, None),
    ]
    monkeypatch.setattr(stage, "_judge", lambda *_: results.pop(0))
    made = stage.coverage_stage(None, [None, None], [None, None], workspace)
    again = stage.coverage_stage(None, [None, None], [None, None], workspace)  # `results` is empty now
    for found in (made, again):
        assert [result.record for result in found] == [
            {"judged": True, "covered_percent": 81.25, "visited": [[0.0, 2.5]]},
            {"judged": False},
        ]
        assert [result.picture for result in found] == [tmp_path / "coverage.png", None]
        assert [len(result.missed) for result in found] == [2, 0]
        np.testing.assert_array_equal(found[0].missed[1].vertices, patch.vertices)
        np.testing.assert_array_equal(found[0].missed[1].faces, patch.faces)
    assert Workspace(tmp_path).record_path.exists()
