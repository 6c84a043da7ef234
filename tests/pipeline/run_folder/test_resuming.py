"""What a run may be gone on with: the same pictures wherever they lie now, and another scale or fusion."""

import shutil

import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from pipeline.config import _is_of_surface, load_config
from pipeline.run_folder.creating import create_workspace
from pipeline.run_folder.inputs import _digest_of_sizes, digest
from pipeline.run_folder.resuming import FROM_SURFACE, resume_workspace
from pipeline.run_folder.workspace import open_workspace

STAGES = ("frames", "structure", "points", "depth", "refinement", "motion", *FROM_SURFACE)


@pytest.fixture
def film(tmp_path):
    """A folder of pictures that are not compressed, all of one size."""
    folder, rng = tmp_path / "film", np.random.default_rng(0)
    folder.mkdir()
    for number in range(4):
        cv2.imwrite(str(folder / f"{number:05d}.bmp"), rng.integers(0, 255, (32, 40, 3), dtype=np.uint8))
    return folder


@pytest.fixture
def run(tmp_path, film):
    with create_workspace(tmp_path / "run", film, load_config(None), overwrite=False) as workspace:
        for stage in STAGES:
            workspace.finish(stage)
    return tmp_path / "run"


@pytest.mark.parametrize(
    "changed",
    [
        {"lumen_mm": 40.0},
        {"scale_file": "scale.yaml"},
        {"fusion": {"voxel_size": 0.01}},
        {"consistency": {"tolerance": 0.2}},
    ],
)
def test_another_scale_or_fusion_makes_the_surface_anew_and_nothing_before_it(run, film, changed):
    config = load_config(None, **changed)
    with pytest.raises(HaustraError, match="add --resume to make its surface anew"):
        create_workspace(run, film, config, overwrite=False)
    with resume_workspace(run, film, config) as workspace:
        assert workspace.made_anew
        assert set(workspace.record["stages"]) == set(STAGES) - set(FROM_SURFACE)
        assert workspace.config == config
    with resume_workspace(run, film, config) as again:
        assert not again.made_anew


def test_a_scale_that_is_not_given_again_is_not_taken_away(tmp_path, film):
    config, folder = load_config(None, lumen_mm=40.0), tmp_path / "run"
    with create_workspace(folder, film, config, overwrite=False) as workspace:
        workspace.finish("surface")
    with pytest.raises(HaustraError, match=r"with other settings \(lumen_mm: 40.0, now None\); repeat them"):
        resume_workspace(folder, film, load_config(None))
    with resume_workspace(folder, film, load_config(None, lumen_mm=50.0)) as workspace:
        assert workspace.made_anew == "lumen_mm: 40.0, now 50.0"


def test_a_wish_that_is_refused_leaves_the_run_as_it_was(run, film):
    before = open_workspace(run).record
    (run / "report.html").write_text("old")

    def fail(begun: bool, **changed):
        with resume_workspace(run, film, load_config(None, **changed)) as workspace:
            if begun:
                workspace.replace_surface()
            raise HaustraError("the keyframes agree on no surface")

    with pytest.raises(HaustraError, match="agree on no surface"):
        fail(False, fusion={"min_observations": 50})
    assert open_workspace(run).record == before
    with pytest.raises(HaustraError, match="agree on no surface"):
        fail(True, lumen_mm=3.0)
    assert "surface" not in open_workspace(run).record["stages"]
    assert not (run / "report.html").exists()  # of the surface before


def test_the_same_scale_file_elsewhere_is_the_same(tmp_path, film):
    paths, folder = [tmp_path / "a.yaml", tmp_path / "b.yaml"], tmp_path / "run"
    for path in paths:
        path.write_text("mm_per_unit: 2")
    first, second = (load_config(None, scale_file=str(path)) for path in paths)
    with create_workspace(folder, film, first, overwrite=False) as workspace:
        workspace.finish("surface")
    with resume_workspace(folder, film, second) as workspace:
        assert workspace.is_done("surface")
    paths[1].write_text("mm_per_unit: 3")
    with resume_workspace(folder, film, second) as workspace:
        assert workspace.made_anew


def test_which_settings_are_of_the_surface_alone():
    for name in ("scale_file", "lumen_mm", "poses.mm_per_unit", "fusion.voxel_size", "consistency.tolerance"):
        assert _is_of_surface(name)
    for name in ("poses.file", "seed", "depth.multiview", "sensor.unit_mm", "frames.end_s"):
        assert not _is_of_surface(name)


def test_a_scale_file_that_has_changed_makes_the_surface_anew(tmp_path, film):
    path, folder = tmp_path / "scale.yaml", tmp_path / "run"
    path.write_text("mm_per_unit: 2")
    config = load_config(None, scale_file=str(path))
    with create_workspace(folder, film, config, overwrite=False) as workspace:
        workspace.finish("depth")
        workspace.finish("surface")
    path.write_text("mm_per_unit: 3")
    with resume_workspace(folder, film, config) as workspace:
        assert list(workspace.record["stages"]) == ["depth"]
    with resume_workspace(folder, film, config) as workspace:
        assert not workspace.made_anew


def test_a_run_goes_on_with_a_source_that_was_moved_and_knows_where_it_is(run, film):
    moved = film.rename(film.with_name("moved"))
    with resume_workspace(run, moved, load_config(None)) as workspace:
        assert set(workspace.record["stages"]) == set(STAGES)
    assert open_workspace(run).record["source"]["path"] == str(moved)


def test_pictures_of_one_size_are_told_apart_by_what_they_show(run, film):
    picture = cv2.imread(str(film / "00002.bmp"))
    cv2.imwrite(str(film / "00002.bmp"), 255 - picture)
    with pytest.raises(HaustraError, match="a run of another video"):
        resume_workspace(run, film, load_config(None))


def test_a_run_in_its_source_and_what_file_browsers_leave_change_no_source(film):
    folder, before = film / "film_run", digest(film)
    for name in (".DS_Store", "Thumbs.db"):
        (film / name).write_bytes(b"browser")
    (film / "@eaDir").mkdir()
    (film / "@eaDir" / "00000.bmp").write_bytes(b"thumbnail")
    with create_workspace(folder, film, load_config(None), overwrite=False) as workspace:
        workspace.images.mkdir()
        shutil.copy(film / "00000.bmp", workspace.images)
        workspace.finish("frames")
    assert digest(film) == before
    with resume_workspace(folder, film, load_config(None)) as workspace:
        assert workspace.is_done("frames")


def test_a_users_own_run_yaml_hides_no_picture(tmp_path, film):
    (film / "run.yaml").write_text("mine")
    before = digest(tmp_path)
    (film / "00001.bmp").write_bytes((film / "00001.bmp").read_bytes()[::-1])
    assert digest(tmp_path) != before


def test_a_run_of_version_01_goes_on(run, film):
    record = open_workspace(run)
    record.record["source"]["sha256"]["source"] = _digest_of_sizes(film)
    record.save()
    with resume_workspace(run, film, load_config(None)) as workspace:
        assert workspace.is_done("depth")
    (film / "00009.bmp").write_bytes(b"one more")
    with pytest.raises(HaustraError, match="a run of another video"):
        resume_workspace(run, film, load_config(None))


@pytest.mark.parametrize("name", ["images", "lens.json", "mesh_2.ply"])
def test_a_run_is_not_replaced_by_one_of_its_own_files(run, film, name):
    (run / "images").mkdir()
    for file in ("images/000000.jpg", "lens.json", "mesh_2.ply"):
        (run / file).write_bytes(b"of the run")
    source, camera = (run / name, "auto") if name == "images" else (film, str(run / name))
    with pytest.raises(HaustraError, match=r"is one of the files of the run .* give another output folder"):
        create_workspace(run, source, load_config(None, camera=camera), overwrite=True)
    assert (run / "images/000000.jpg").read_bytes() == b"of the run"
    assert open_workspace(run).record["stages"]


def test_a_name_that_is_no_text_is_refused(tmp_path, film):
    name = b"gr\xfcn".decode(errors="surrogateescape")
    with pytest.raises(HaustraError, match="bytes that are no UTF-8"):
        create_workspace(tmp_path / name, film, load_config(None), overwrite=False)
