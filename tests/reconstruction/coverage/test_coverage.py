"""Coverage against closed forms: tubes with holes of known place and size, and what must not change the answer."""

import numpy as np
import pytest
from hypothesis import Phase, given, settings
from hypothesis import strategies as st
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from pipeline.report.page.summary import Link, coverage_section
from pipeline.surface.coverage_stage import CoverageResult
from reconstruction.coverage import hole_closing as closed_wall
from reconstruction.coverage import unrolled_map as maps
from reconstruction.coverage.centreline import NotATube, WallRays, lumen_radius, trace_centreline
from reconstruction.coverage.coverage import measure_coverage
from reconstruction.coverage.coverage_figure import draw_coverage
from reconstruction.coverage.missed_regions import hidden_probability
from reconstruction.coverage.unrolled_map import MISSED, NOT_JUDGED, SEEN, unroll
from reconstruction.evaluation.coverage_metrics import TrueWall, coverage_errors
from reconstruction.mesh.surface_mesh import SurfaceMesh
from tests.helpers.tubes.holed_tube import BEND, EDGE, HOLE, LENGTH, RADIUS, bent, cameras, patch, straight, tube


@pytest.fixture(scope="module")
def holed():
    """A cylinder with a hole of 15 mm x 60 degrees at 3 o'clock, and its coverage."""
    mesh = tube(straight, HOLE)
    return mesh, measure_coverage(mesh, cameras(straight))


@pytest.fixture(scope="module")
def holed_bend():
    """The same hole in a torus, on the side of the bend's centre."""
    mesh, world_from_camera = tube(bent, HOLE, length=100.0), cameras(bent, end=60.0)
    return mesh, world_from_camera, measure_coverage(mesh, world_from_camera)


def test_a_whole_tube_is_seen_whole():
    """By cameras that go in and come out again: the path is one line all the same."""
    world_from_camera = cameras(straight)
    coverage = measure_coverage(tube(straight), np.concatenate([world_from_camera, world_from_camera[::-1]]))
    assert (coverage.share, coverage.regions) == (1.0, [])
    assert coverage.radius == pytest.approx(RADIUS, rel=0.02)
    # Half a view of 45 degrees: wall leaves the picture one radius ahead of the camera.
    assert coverage.length == pytest.approx(80, abs=2)
    wall = coverage.whole
    assert wall.seen_area == pytest.approx(2 * np.pi * RADIUS * coverage.length, rel=0.02)


@pytest.mark.parametrize("shape", ["cylinder", "torus"])
def test_a_hole_of_known_area_place_and_angle(shape, holed, holed_bend):
    middle, length, end = (straight, LENGTH, 90.0) if shape == "cylinder" else (bent, 100.0, 60.0)
    coverage = holed[-1] if shape == "cylinder" else holed_bend[-1]
    lid = tube(middle, lambda s, angle: ~HOLE(s, angle), length=length)
    (region,) = [r for r in coverage.regions if r.diameter > 2]
    assert region.area == pytest.approx(lid.face_areas.sum(), rel=0.1)
    assert region.clock == pytest.approx(3.0, abs=0.2)
    farthest = cKDTree((holed if shape == "cylinder" else holed_bend)[0].vertices).query(lid.vertices)[0].max()
    assert region.reach == pytest.approx(farthest, abs=EDGE)
    assert hidden_probability(region.reach / coverage.radius) > 0.5
    assert region.arc == pytest.approx(62.5 - (10 + RADIUS), abs=2)  # the first camera, and a radius ahead of it
    assert np.subtract(*region.arc_range[::-1]) == pytest.approx(15, abs=2.5)
    assert np.linalg.norm(np.array(region.centre) - lid.vertices.mean(axis=0)) < 2
    # The nearest camera that has it in view is a radius before it. No camera has the bend's inner side within 45
    # degrees of its axis, so there it is the nearest of all.
    expected = 62.5 - RADIUS if shape == "cylinder" else end
    assert np.linspace(10, end, 30)[region.frame] == pytest.approx(expected, abs=3)


@pytest.mark.parametrize(
    "start",
    [
        pytest.param(start, marks=pytest.mark.slow) if k % 5 else start
        for k, start in enumerate(np.linspace(12, 96, 11))
    ],
)
def test_a_region_lies_within_the_stretch_that_is_judged(start):
    """Holes over both ends of it: their faces reach out, what is said of them does not."""
    coverage = measure_coverage(tube(straight, lambda s, a: patch(start, start + 12, 60, 120)(s, a)), cameras(straight))
    assert bool(coverage.regions) == (start > 12)  # the first hole ends before the stretch begins
    for region in coverage.regions:
        assert 0 <= region.arc_range[0] <= region.arc <= region.arc_range[1] <= coverage.length + 1e-9


def test_a_needle_of_the_closing_without_area_is_no_region(holed, monkeypatch):
    """Poisson's surface has such triangles; one that stands off the wall was once a region, and its middle 0 / 0."""
    poisson = closed_wall._poisson

    def with_needle(mesh, cell):
        vertices, faces = poisson(mesh, cell)
        foot = int(np.linalg.norm(vertices - vertices[faces].mean(axis=(0, 1)), axis=1).argmin())
        tip = vertices[foot] * (0.5, 0.5, 1)  # half way to the lumen's middle
        return np.vstack([vertices, tip]), np.vstack([faces, [foot, foot, len(vertices)]])

    monkeypatch.setattr(closed_wall, "_poisson", with_needle)
    coverage = measure_coverage(holed[0], cameras(straight))
    assert (len(coverage.regions), coverage.share) == (len(holed[1].regions), pytest.approx(holed[1].share))


def test_the_pocket_behind_a_fold_is_a_missed_region():
    """A crescent 8 mm deep; the wall for 10 mm behind it is unobserved. A flat lid over the hole would measure a
    third less than the fold's hidden flank and the wall together."""

    def fold(s, angle):
        crescent = np.clip(np.cos(angle - np.pi), 0, 1) ** 0.5
        return RADIUS - 8 * crescent * np.exp(-(((s - 60) / 3) ** 2))

    def hidden(s, angle):
        return (s > 60) & (s < 72) & (np.abs(angle - np.pi) < 1.0)

    mesh, pocket = tube(straight, hidden, radius=fold), tube(straight, lambda s, a: ~hidden(s, a), radius=fold)
    coverage = measure_coverage(mesh, cameras(straight))
    (region,) = [r for r in coverage.regions if r.diameter > 2]
    assert region.clock == pytest.approx(6, abs=0.2)
    assert region.area == pytest.approx(pocket.face_areas.sum(), rel=0.2)


def test_only_the_visited_stretch_is_judged():
    """A hole beyond what the cameras passed lies on the map as not judged, and costs nothing."""
    mesh = tube(straight, patch(95, 110, 0, 360))
    coverage = measure_coverage(mesh, cameras(straight, end=60))
    assert coverage.stretch[1] == pytest.approx(50, abs=2)
    assert coverage.share > 0.999
    unrolled_map = unroll(coverage, mesh)
    middle = (unrolled_map.arc_edges[1:] + unrolled_map.arc_edges[:-1]) / 2
    assert (unrolled_map.state[(middle < 0) | (middle > coverage.length)] == NOT_JUDGED).all()
    assert (unrolled_map.state[(middle > 0) & (middle < coverage.length)] == SEEN).all()


def test_cameras_that_look_the_other_way_turn_the_line_round():
    world_from_camera = cameras(straight, start=30.0)
    world_from_camera[:, :3, :3] = (
        world_from_camera[:, :3, :3] @ Rotation.from_euler("y", 180, degrees=True).as_matrix()
    )
    coverage = measure_coverage(tube(straight, patch(35, 50, 60, 120)), world_from_camera)
    (region,) = [r for r in coverage.regions if r.diameter > 2]
    assert region.clock == pytest.approx(9.0, abs=0.2)  # right becomes left
    assert region.arc == pytest.approx(90 - RADIUS - 42.5, abs=2)


def test_the_line_of_a_bend_lies_in_its_middle():
    mesh, world_from_camera = tube(bent, patch(20, 45, 100, 200), length=94.0), cameras(bent, end=60, off=6.0)
    line = trace_centreline(mesh, world_from_camera, lumen_radius(WallRays(mesh), world_from_camera))
    inside = (line.points[:, 2] > 10) & (line.points[:, 0] < 45)
    to_centre = np.hypot(line.points[:, 0] - BEND, line.points[:, 2])[inside]
    np.testing.assert_allclose(to_centre, BEND, atol=2.0)
    np.testing.assert_allclose(line.points[inside, 1], 0, atol=2.0)
    assert np.abs(np.einsum("ni,ni->n", line.twelve, line.tangents)).max() < 1e-6


@settings(max_examples=2, deadline=None, derandomize=True, phases=[Phase.generate])  # shrinking would take minutes
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-500, 500)] * 3),
    scale=st.floats(0.01, 30),
    seed=st.integers(0, 99),
)
def test_the_answer_moves_turns_and_scales_with_the_mesh(holed_bend, turn, shift, scale, seed):
    mesh, world_from_camera, here = holed_bend
    moved = np.eye(4)
    moved[:3, :3], moved[:3, 3] = Rotation.from_rotvec(turn).as_matrix(), shift
    order = np.random.default_rng(seed).permutation(len(mesh.vertices))
    shuffled = SurfaceMesh.from_triangles(mesh.vertices[order], np.argsort(order)[mesh.faces])
    other_poses = moved @ world_from_camera
    other_poses[:, :3, 3] *= scale
    similarity = np.diag([scale, scale, scale, 1.0]) @ moved
    there = measure_coverage(shuffled.transformed(similarity), other_poses)
    assert there.share == pytest.approx(here.share, abs=2e-3)
    assert there.length == pytest.approx(scale * here.length, rel=5e-3)
    ours, theirs = here.regions[0], there.regions[0]
    assert theirs.area == pytest.approx(scale**2 * ours.area, rel=0.02)
    assert theirs.clock == pytest.approx(ours.clock, abs=0.05)
    assert theirs.reach == pytest.approx(scale * ours.reach, rel=0.02)
    told = [hidden_probability(found.regions[0].reach / found.radius) for found in (here, there)]
    assert told[1] == pytest.approx(told[0], abs=0.01)
    np.testing.assert_allclose(
        theirs.centre, similarity[:3, :3] @ np.array(ours.centre) + similarity[:3, 3], atol=0.3 * scale
    )


def test_what_is_no_tube_gets_one_sentence():
    plane = tube(straight, lambda s, angle: np.abs(angle - np.pi) > 0.9)
    for mesh, world_from_camera, words in (
        (SurfaceMesh.from_triangles([], []), cameras(straight), "no surface"),
        (tube(straight), cameras(straight, count=1), "one camera"),
        (tube(straight), cameras(straight, start=40, end=41, off=0), "hardly moves"),
        (plane, cameras(straight), "too open"),
        (tube(straight, lambda s, angle: s > 5), cameras(straight, start=50), "judge"),
    ):
        with pytest.raises(NotATube, match=words):
            measure_coverage(mesh, world_from_camera)


def test_the_map_shows_the_hole_where_it_is(holed):
    mesh, coverage = holed
    unrolled_map = unroll(coverage, mesh)
    rows, columns = np.nonzero(unrolled_map.state == MISSED)
    arc = (unrolled_map.arc_edges[rows] + unrolled_map.arc_edges[rows + 1]) / 2
    assert arc.mean() == pytest.approx(62.5 - 30, abs=2)
    assert np.degrees(unrolled_map.angle_edges[columns]).min() == pytest.approx(60, abs=6)
    assert np.degrees(unrolled_map.angle_edges[columns + 1]).max() == pytest.approx(120, abs=6)
    assert set(unrolled_map.region[rows, columns]) == {0}
    assert (unrolled_map.colour[unrolled_map.state == SEEN] == 200).all()


def test_the_map_is_the_same_however_many_faces_are_taken_at_once(holed, monkeypatch):
    mesh, coverage = holed
    whole = unroll(coverage, mesh)
    monkeypatch.setattr(maps, "CHUNK", 101)
    for name, found in vars(unroll(coverage, mesh)).items():
        np.testing.assert_array_equal(found, getattr(whole, name))


def test_the_picture_is_written(tmp_path, holed):
    import cv2

    mesh, coverage = holed
    draw_coverage(coverage, unroll(coverage, mesh), coverage.segments(50), 1, tmp_path / "coverage.png")
    picture = cv2.imread(str(tmp_path / "coverage.png"))
    assert picture.shape[1] > 1000
    blue = (picture[..., 0] > 200) & (picture[..., 2] < 60)
    assert 0.003 < blue.mean() < 0.1


def test_segments_add_up(holed):
    parts = holed[-1].segments(25)
    assert len(parts) == 3
    assert sum(p.seen_area for p in parts) == pytest.approx(holed[-1].whole.seen_area, rel=1e-9)
    assert [p.share < 0.999 for p in parts] == [False, True, False]


def test_errors_against_a_wall_that_knows_what_was_seen():
    """The estimate misses one of two true holes and has one of its own."""
    true_hole, other_hole, own_hole = patch(55, 70, 60, 120), patch(40, 50, 200, 240), patch(80, 92, 280, 330)
    whole = tube(straight)
    s, angle = whole.vertices[whole.faces].mean(axis=1)[:, 2], np.arctan2(*_around(whole)) % (2 * np.pi)
    wall = TrueWall(whole, ~(true_hole(s, angle) | other_hole(s, angle)))
    mesh = tube(straight, lambda s, a: true_hole(s, a) | own_hole(s, a))
    errors = coverage_errors(measure_coverage(mesh, cameras(straight)), wall)
    assert (errors.true_regions, errors.found, errors.estimated_regions, errors.false) == (2, 1, 2, 1)
    area = 2 * np.pi * RADIUS * errors.length
    expected = (10 * 40 - 12 * 50) * np.pi / 180 * RADIUS / area * 100
    assert errors.error_points == pytest.approx(expected, abs=1.0)
    assert "1 of 2 found, 1 not found; 1 false of 2" in str(errors)


def _around(mesh):
    """x and -y of the faces' centres."""
    centres = mesh.vertices[mesh.faces].mean(axis=1)
    return centres[:, 0], -centres[:, 1]


def test_the_edge_tolerance_gives_back_what_voxels_take(holed):
    mesh, bare = holed
    tolerant = measure_coverage(mesh, cameras(straight), edge_tolerance=1.5)
    lost = bare.regions[0].area - tolerant.regions[0].area
    perimeter = 2 * (15 + np.pi / 3 * RADIUS)
    assert lost == pytest.approx(1.5 * perimeter - 4 * 1.5**2, rel=0.25)


def test_the_report_has_a_table_or_one_sentence(tmp_path):
    section = coverage_section(CoverageResult({"judged": False, "reason": "there is < no surface"}, None), {})
    assert section == "<h2>Coverage</h2><p>There is &lt; no surface.</p>"
    (tmp_path / "coverage.png").write_bytes(b"")
    row = {"number": 1, "area": 50, "diameter": 8, "arc": 3, "clock": 2, "frame": 7, "seconds": 0.2}
    record = {"judged": True, "unit": "mm", "covered_percent": 90.0, "stretch": 80.0, "listed_from": 5.0}
    record |= {"smaller_regions": 4, "missed_regions": [row, row]}
    section = coverage_section(CoverageResult(record, tmp_path / "coverage.png"), {1: Link("#keyframe-5", 9, False)})
    assert section.count("<tr>") == 3
    assert section.count('data-region="1" href="#keyframe-5">frame 9</a>, not in the picture') == 2
    assert "90.0 % of the wall" in section
    assert "±" not in section  # a run made before its error and the regions' probabilities were told
    record |= {
        "covered_error_points": 3.6,
        "missed_regions": [row | {"probability": 0.826}, row | {"probability": 0.2}],
    }
    section = coverage_section(CoverageResult(record, tmp_path / "coverage.png"), {1: Link("#keyframe-5", 9, False)})
    assert "90.0 ± 3.6 % of the wall" in section
    assert "(1 of them more likely hidden than not)" in section
    assert "<td>83 %</td>" in section
    assert "root mean square" in section
    del record["covered_error_points"]  # the lens was not given
    section = coverage_section(CoverageResult(record, tmp_path / "coverage.png"), {1: Link("#keyframe-5", 9, False)})
    assert "±" not in section
    assert "Hidden: how likely" in section
