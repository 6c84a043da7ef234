"""What a run is compared with: a truth that does not hold the wall that no frame saw says so."""

import json
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
import trimesh

from haustra.core.camera import Camera
from haustra.core.errors import HaustraError
from pipeline import compare
from pipeline.config import Config, FrameSettings
from pipeline.truth.film_part import FilmPart, cut_note
from reconstruction.evaluation.reference_surface import ALL_TIMES
from reconstruction.evaluation.trajectory_io import write_tum
from reconstruction.mesh.mesh_io import write_mesh
from reconstruction.mesh.surface_mesh import SurfaceMesh

WHOLE = FilmPart(*ALL_TIMES, False)


def workspace_of(folder, seconds, frames=None):
    """Of a run that read frames at these times, all of its film from the first on."""
    stride = 1 if frames is None else frames.stride
    listed = [[stride * k, float(at), "used"] for k, at in enumerate(seconds)]
    (folder / "frames.json").write_text(json.dumps({"frames": listed}))
    config = Config(frames=frames or FrameSettings())
    record = {"source": {"path": "film.mp4"}}
    return SimpleNamespace(config=config, frames=folder / "frames.json", record=record)


def test_coverage_cannot_be_compared_with_a_mesh_of_seen_wall_alone(tmp_path):
    assert compare._coverage(None, np.eye(4), tmp_path, None, True) is None  # no mesh at all
    write_mesh(SurfaceMesh.from_triangles(np.eye(3), [[0, 1, 2]]), tmp_path / "mesh.ply")
    assert "does not hold the wall that no frame saw" in compare._coverage(None, np.eye(4), tmp_path, None, True)


def test_true_coverage_is_compared_where_the_truth_has_no_depth(tmp_path, monkeypatch):
    """C3VD's coverage mesh knows which wall was seen, with or without the depth images."""
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, :3, 3] = rng.normal(size=(5, 3))
    run = SimpleNamespace(
        workspace=workspace_of(tmp_path, np.arange(5.0)),
        metrics={"submaps": [{"unit": "scene"}], "frames": {"posed": 5, "total": 5}},
        trajectory=lambda: (np.arange(5.0), poses),
        submaps=[None],
        mesh=tmp_path / "mesh.ply",
    )
    monkeypatch.setattr(compare, "open_run", lambda _: run)
    monkeypatch.setattr(compare, "_coverage", lambda *_: "asked")
    write_tum(tmp_path / "truth.tum", np.arange(5.0), poses)
    found = compare.compare_run(tmp_path, tmp_path / "truth.tum")
    assert (found.surface, found.coverage) == (None, "asked")


@pytest.mark.parametrize("tau", [0.2, 0.5, 1.0, 3.0])
def test_a_perfect_surface_is_perfect_at_every_distance(tmp_path, tau):
    ball = trimesh.creation.icosphere(subdivisions=3, radius=6)
    mesh = SurfaceMesh.from_triangles(np.asarray(ball.vertices), np.asarray(ball.faces))
    write_mesh(mesh, tmp_path / "mesh.ply")
    truth = compare._true_surface(tmp_path, None, compare.spacing_of(tau), np.zeros(1), WHOLE)
    errors = compare._surface(mesh, np.eye(4), truth, tau)
    assert min(errors.precision, errors.recall) > 0.99


def test_a_distance_finer_than_the_truth_can_be_is_refused_where_there_is_a_surface(tmp_path):
    path = tmp_path / "trajectory.txt"
    path.write_text("0 0 0 0 0 0 0 1\n")
    assert compare._true_surface(path, None, compare.spacing_of(0.1), np.zeros(1), WHOLE) is None
    with pytest.raises(HaustraError, match=r"F-score at 0\.1 mm cannot be measured"):
        compare._true_surface(tmp_path, None, compare.spacing_of(0.1), np.zeros(1), WHOLE)


def two_walls(folder):
    """Two frames a second apart, from one place, see two walls, of which one is behind the other."""
    camera = Camera("PINHOLE", 8, 8, (8.0, 8.0, 4.0, 4.0), True)
    (folder / "depth").mkdir()
    (folder / "camera.json").write_text(json.dumps(camera.to_dict() | {"depth_unit_mm": 0.01}))
    write_tum(folder / "trajectory.txt", np.array([0.0, 1.0]), np.tile(np.eye(4), (2, 1, 1)))
    for number, wall in enumerate((10, 20)):
        cv2.imwrite(str(folder / f"depth/{number:05d}.png"), np.full((8, 8), 100 * wall, np.uint16))


@pytest.mark.parametrize(
    ("start_s", "end_s", "film", "walls"),
    [
        (0.0, None, (0.0, 1.0), [10, 20]),
        (0.0, 0.5, (0.0, 0.4), [10]),
        (0.5, None, (0.6, 1.0), [20]),
        (0.0, None, (0.0, 0.9), [10, 20]),  # its clock is a tenth of a frame off
        (0.0, None, (0.0, 0.6), [10]),  # cut beforehand, which no option tells
        (0.0, None, (0.6, 1.0), [20]),
    ],
)
def test_a_run_of_a_part_of_the_film_is_measured_by_the_wall_of_that_part(tmp_path, start_s, end_s, film, walls):
    two_walls(tmp_path)
    seconds = np.array([0.0, 1.0])
    step = 0.9 if film == (0.0, 0.9) else 0.2
    read = np.arange(film[0], film[1] + 0.01, step)
    part = FilmPart.of(workspace_of(tmp_path, read, FrameSettings(start_s=start_s, end_s=end_s)))
    surface = compare._true_surface(tmp_path, None, 0.5, seconds, part)
    assert sorted(set(surface.required[:, 2].round(6))) == walls
    assert part.is_less_than(seconds) == (walls != [10, 20])
    told = cut_note(part, seconds)
    assert [note.split(":")[0] for note in told] == [
        f"the wall is cut to what {len(walls)} of the 2 true frames saw" for _ in range(2 - len(walls))
    ]
    assert compare.part_hint(tmp_path, None) == ""
    (tmp_path / "wall_motion.json").write_text("{}")
    assert compare.part_hint(tmp_path, None)


@pytest.mark.parametrize(("stride", "count"), [(1, 80), (2, 40), (3, 27), (7, 12)])
def test_a_stride_leaves_no_frame_of_the_whole_film_out(tmp_path, stride, count):
    """The last frame that is read is up to a stride before the film's last."""
    read = np.arange(0, 80, stride) / 30
    assert len(read) == count
    part = FilmPart.of(workspace_of(tmp_path, read, FrameSettings(stride=stride)))
    assert not part.is_less_than(np.arange(80) / 30)
    assert part.holds(np.arange(160) / 30).sum() < 80 + stride


def test_coverage_of_a_film_that_was_cut_is_not_compared_with_that_of_the_whole(tmp_path, monkeypatch):
    (tmp_path / "mesh.ply").write_text("")
    monkeypatch.setattr(compare, "read_true_wall", lambda _: "a wall with what no frame saw")
    assert "of a part of the film" in compare._coverage(None, np.eye(4), tmp_path, None, False)
