"""Depth of a sensor in a tube whose wall is known: its scale, its points, and what it says when it cannot be right."""

import re
from contextlib import nullcontext
from dataclasses import replace

import cv2
import numpy as np
import pytest

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from pipeline.config import Config, SensorSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sensor.gathered_points import SensedFilm
from pipeline.depth.sensor.joined_points import join, points_of
from pipeline.depth.sensor.sensor_points import sensor_points
from pipeline.depth.sensor.sensor_scale import sensor_scale
from pipeline.depth.sparse_depth import SparseDepth
from pipeline.input.frames import Frames
from pipeline.input.sensor import sensor_depth
from pipeline.input.sensor.sensor_depth import SensorDepth, check_sensor, open_sensor
from pipeline.input.sensor.usual_distances import doubt_of_unit
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.given_scales import scale_of_sensor
from pipeline.surface.scale import ScaleSource, find_scale
from tests.helpers.tubes.sensed_tube import (
    BOX,
    CAMERA,
    COUNT,
    MM_PER_UNIT,
    SCALE,
    SOURCE,
    submap,
    through,
    wall_depth,
    write_sensor,
)


@pytest.fixture
def workspace(tmp_path):
    write_sensor(tmp_path / "depth")
    found = Workspace(tmp_path / "run")
    found.root.mkdir()
    config = Config(sensor=SensorSettings(folder=str(tmp_path / "depth"), unit_mm=0.05, error_mm=0.0))
    found.record |= {"config": config.model_dump(mode="json"), "source": {"path": str(tmp_path / "film.mp4")}}
    found.finish("frames", content_box=list(BOX), source_size=list(SOURCE))
    return found


@pytest.fixture
def sensor(workspace):
    return open_sensor(workspace, CAMERA.width)


def test_the_scale_is_found_through_noise_holes_and_a_cropped_picture(sensor):
    found = sensor_scale(submap(), sensor)
    assert found.mm_per_unit == pytest.approx(MM_PER_UNIT, rel=0.005)
    assert found.count > 1000
    assert 0.01 < found.disagreement < 0.06
    scale = find_scale(ScaleSource(given=(scale_of_sensor(found),)).of_submap(0), submap(), None)
    assert (scale.unit, scale.factor) == ("mm", found.mm_per_unit)


def test_its_points_lie_on_the_wall(sensor):
    pinhole = make_rectifier(CAMERA).camera
    found = sensor_points(sensor, 7, CAMERA, pinhole, MM_PER_UNIT)
    assert len(found.depth) > 300
    np.testing.assert_allclose(found.error, 0.02, atol=1e-9)
    true = wall_depth(through(pinhole, found.pixels), 7) / MM_PER_UNIT
    off = np.log(found.depth / true)
    assert abs(np.median(off)) < 0.004
    assert np.median(np.abs(off)) < 0.02


def test_they_join_those_of_the_map(sensor, workspace):
    completed = CompletedSubmap(submap(), make_rectifier(CAMERA), np.arange(COUNT), DiskKeyframes(workspace))
    frames = Frames(np.arange(COUNT), np.arange(COUNT) / 30, CAMERA, np.full((90, 100), 255, np.uint8), {})
    alone = points_of(completed, frames, None, SilentProgress())(7)
    both = points_of(completed, frames, sensor, SilentProgress())(7)
    assert len(both.depth) > len(alone.depth) + 250
    of = {
        points: points_of(
            completed,
            frames,
            replace(sensor, settings=sensor.settings.model_copy(update={"points": points})),
            SilentProgress(),
        )(7)
        for points in ("own", "none")
    }
    np.testing.assert_array_equal(of["none"].depth, alone.depth)
    own = sensor_points(sensor, 7, CAMERA, completed.camera, sensor_scale(submap(), sensor).mm_per_unit)
    assert np.isin(of["own"].depth, np.concatenate([alone.depth, own.depth])).all()
    assert len(of["own"].depth) > len(alone.depth) + 250
    lone = SparseDepth(np.array([[50.0, 40.0]]), np.array([9.0]), np.array([0.01]))
    assert 9.0 not in join(both, lone).depth  # nothing around is so deep


@pytest.mark.parametrize("factor", [10.0, 0.1])
def test_a_wrong_unit_is_one_sentence(sensor, factor):
    with pytest.raises(HaustraError, match="endoscopes look from 4 to 250 mm: check the depth's unit"):
        sensor_scale(submap(), replace(sensor, unit_mm=factor * sensor.unit_mm))


@pytest.mark.parametrize(
    ("factor", "told"), [(1.0, ""), (4.0, "checked the depth's unit"), (0.25, "checked the depth's unit")]
)
def test_a_unit_that_few_views_have_is_doubted_aloud(sensor, factor, told):
    scale = scale_of_sensor(sensor_scale(submap(), replace(sensor, unit_mm=factor * sensor.unit_mm)))
    assert told in scale.doubt
    assert bool(told) == bool(scale.doubt)


@pytest.mark.parametrize("median_mm", np.geomspace(8.5, 79.0, 12))
def test_a_unit_off_by_ten_is_never_silent(median_mm):
    assert not doubt_of_unit(median_mm, False)
    for wrong in (median_mm / 10, median_mm * 10):
        assert doubt_of_unit(wrong, False)


@pytest.mark.parametrize("unit_mm", [0.005, 1.0])
def test_a_wrong_unit_is_refused_before_any_work(tmp_path, unit_mm):
    write_sensor(tmp_path / "depth")
    check_sensor(tmp_path, SensorSettings(folder=str(tmp_path / "depth"), unit_mm=0.05), 0)
    with pytest.raises(HaustraError, match="endoscopes look from 4 to 250 mm: check the depth's unit"):
        check_sensor(tmp_path, SensorSettings(folder=str(tmp_path / "depth"), unit_mm=unit_mm), 0)


def test_a_damaged_depth_image_is_called_damaged(tmp_path):
    """Its head and its end are whole, so that the check before the work lets it pass."""
    path = tmp_path / "00000.png"
    cv2.imwrite(str(path), np.random.default_rng(0).integers(0, 60000, (200, 200)).astype(np.uint16))
    data = bytearray(path.read_bytes())
    data[2000:6000] = bytes(4000)
    path.write_bytes(data)
    with pytest.raises(HaustraError, match="is a damaged depth image: copy it anew"):
        sensor_depth._read_depth(path)


@pytest.mark.parametrize(("shape", "doubted"), [((12, 16), False), ((9, 13), False), ((12, 12), True)])
def test_depth_of_another_ratio_of_sides_is_doubted_aloud(sensor, tmp_path, shape, doubted):
    """A coarse grid of the whole picture is rounded by up to a cell; a square of 4:3 may be another crop."""
    cv2.imwrite(str(tmp_path / "00007.png"), np.full(shape, 800, np.uint16))
    seen = replace(sensor, files={7: tmp_path / "00007.png"}, size=(640, 480))
    assert ("right where they show the whole picture" in seen.doubt_of_shape) == doubted


@pytest.mark.parametrize(("frames", "refused"), [(4, False), (60, False), (400, True)])
def test_depth_of_another_film_is_told_by_its_count(tmp_path, frames, refused):
    (tmp_path / "depth").mkdir()
    for number in range(4):
        cv2.imwrite(str(tmp_path / f"depth/{number:05d}.png"), np.full((8, 8), 800, np.uint16))
    settings = SensorSettings(folder=str(tmp_path / "depth"), unit_mm=0.05)
    with pytest.raises(HaustraError, match=r"4 of the 4 depth images .* 400 frames") if refused else nullcontext():
        check_sensor(tmp_path, settings, frames)


def test_distance_along_the_ray_is_one_sentence(tmp_path, workspace):
    write_sensor(tmp_path / "ranges", along_ray=True)
    sensor = replace(
        open_sensor(workspace, CAMERA.width), files={k: tmp_path / f"ranges/{k:05d}.png" for k in range(COUNT)}
    )
    told = r"as distances along each pixel's ray .* by 2\.\d % in the median instead of \d\.\d %\)"
    assert re.search(told, sensor_scale(submap(), sensor).doubt)
    assert sensor_scale(submap(), replace(sensor, stereo=True)).doubt == "", "a pair's depth is the program's own"


@pytest.mark.parametrize(
    ("shift", "told"),
    [(3, r"3 frames late.*take 3 from the number"), (-3, r"3 frames early.*add 3 to the number")],
)
def test_depth_shifted_in_time_is_one_sentence(sensor, shift, told):
    moved = {k: sensor.files[k - shift] for k in sensor.files if k - shift in sensor.files}
    with pytest.raises(HaustraError, match=told):
        sensor_scale(submap(), replace(sensor, files=moved))


@pytest.mark.parametrize(
    ("late", "told"),
    [(0, ""), (2, "2 frames or more late;"), pytest.param(-2, "2 frames or more early;", marks=pytest.mark.slow)],
)
def test_depth_so_noisy_that_a_shift_changes_little_is_doubted(tmp_path, workspace, late, told):
    write_sensor(tmp_path / "noisy", noise=0.15)
    sensor = open_sensor(workspace, CAMERA.width)
    files = {k + late: tmp_path / f"noisy/{k:05d}.png" for k in range(COUNT)}
    found = sensor_scale(submap(), replace(sensor, files=files))
    by_file = tmp_path / "scale.yaml"
    by_file.write_text(f"mm_per_unit: {found.mm_per_unit}")
    given = (scale_of_sensor(found),)
    for source in (ScaleSource(given=given), ScaleSource(file=by_file, given=given)):  # whoever gives the millimetres
        doubt = find_scale(source, submap(), None).clock_doubt
        assert told in doubt
        assert bool(told) == bool(doubt)


def test_depth_of_a_camera_that_starts_to_move_is_not_doubted(sensor):
    seen = (whole := submap()).observations[:, 0] < 6
    begun = replace(whole, observations=whole.observations[seen], pixels=whole.pixels[seen])
    assert not sensor_scale(
        begun, replace(sensor, files={k: sensor.files[max(0, k)] for k in range(-5, COUNT)})
    ).clock_doubt


def test_depth_that_looks_elsewhere_is_one_sentence(sensor, tmp_path):
    (tmp_path / "turned").mkdir()
    for path in sensor.files.values():
        cv2.imwrite(str(tmp_path / "turned" / path.name), cv2.imread(str(path), cv2.IMREAD_UNCHANGED)[::-1, ::-1])
    turned = {k: tmp_path / "turned" / path.name for k, path in sensor.files.items()}
    half = replace(sensor, files=turned, box=(90, 70, 200, 180))
    with pytest.raises(HaustraError, match="registered to this camera"):
        sensor_scale(submap(), half)


def test_a_confidence_image_weighs_and_drops(sensor, tmp_path):
    depth, sigma = sensor.image(5)
    (tmp_path / "sensor_confidence").mkdir()
    trust = np.full(depth.shape, 255, np.uint8)
    trust[:10], trust[10:20] = 0, 51
    cv2.imwrite(str(tmp_path / "sensor_confidence/00005.png"), trust)
    weighed, doubt = sensor.image(5)
    assert not weighed[:10].any()
    np.testing.assert_array_equal(weighed[10:], depth[10:])
    np.testing.assert_allclose(doubt[10:20], 5 * sigma[10:20])


def test_what_a_sensor_must_have(tmp_path):
    (tmp_path / "empty").mkdir()
    with pytest.raises(HaustraError, match="unit of the depth"):
        check_sensor(tmp_path, SensorSettings(folder=str(tmp_path / "empty")), 0)
    with pytest.raises(HaustraError, match="no depth images"):
        check_sensor(tmp_path, SensorSettings(folder=str(tmp_path / "empty"), unit_mm=1), 0)
    with pytest.raises(HaustraError, match="no depth/ of a sensor"):
        check_sensor(tmp_path, SensorSettings(depth="sensor"), 0)
    (tmp_path / "camera.json").write_text('{"depth": "sensor", "depth_unit_mm": 0.1}')
    with pytest.raises(HaustraError, match="no depth images"):
        check_sensor(tmp_path, SensorSettings(), 0)
    check_sensor(tmp_path, SensorSettings(depth="none"), 0)
    cv2.imwrite(str(tmp_path / "empty/000.png"), np.zeros((4, 4), np.uint16))
    with pytest.raises(HaustraError, match="hold no depth: all are 0"):
        check_sensor(tmp_path, SensorSettings(folder=str(tmp_path / "empty"), unit_mm=1), 0)


def test_a_sensor_that_sees_nothing_gives_no_scale(sensor):
    nothing = SensorDepth({}, sensor.settings, 0.05, BOX, SCALE, SOURCE)
    assert sensor_scale(submap(), nothing) is None
    assert scale_of_sensor(None) is None


def test_frames_around_outvote_what_one_frame_gets_wrong(sensor, tmp_path):
    """A patch that frame 8 has at half its depth, and one that it has not at all."""
    raw = cv2.imread(str(sensor.files[8]), cv2.IMREAD_UNCHANGED)
    raw[20:28, 4:14] //= 2
    raw[8:16, 30:40] = 0
    (tmp_path / "wrong").mkdir()
    cv2.imwrite(str(tmp_path / "wrong/8.png"), raw)
    wrong = replace(sensor, files=sensor.files | {8: tmp_path / "wrong/8.png"})
    pinhole = make_rectifier(CAMERA).camera
    film = SensedFilm(submap(), wrong, CAMERA, pinhole, MM_PER_UNIT)
    found, alone = film.gathered(8), sensor_points(wrong, 8, CAMERA, pinhole, MM_PER_UNIT)
    off = [np.abs(np.log(p.depth * MM_PER_UNIT / wall_depth(through(pinhole, p.pixels), 8))) for p in (found, alone)]
    assert (off[1] > 0.5).sum() >= 5
    assert (off[0] > 0.3).sum() == 0
    assert np.median(off[0]) < np.median(off[1])
    assert (found.error < alone.error.min()).all()


@pytest.mark.parametrize(
    "cut", [(1, 1), *(pytest.param(cut, marks=pytest.mark.slow) for cut in [(0, 7), (0, 0), (3, 5)])]
)
def test_points_of_cells_that_the_border_cuts_lie_in_the_picture(sensor, cut):
    pinhole = make_rectifier(CAMERA).camera
    pinhole = replace(pinhole, width=pinhole.width - cut[0], height=pinhole.height - cut[1])
    for spacing_px in (1, 4, 6):  # between the sensor's own cells
        coarse = replace(sensor)
        vars(coarse)["spacing_px"] = float(spacing_px)
        found = SensedFilm(submap(), coarse, CAMERA, pinhole, MM_PER_UNIT).gathered(8)
        assert (found.pixels < [pinhole.width, pinhole.height]).all()
        assert (found.maps(pinhole.height, pinhole.width)[0] > 0).sum() > 100


def test_a_film_of_two_frames_is_not_outvoted(sensor):
    pinhole, two = make_rectifier(CAMERA).camera, replace(sensor, files={8: sensor.files[8], 12: sensor.files[12]})
    assert len(SensedFilm(submap(), two, CAMERA, pinhole, MM_PER_UNIT).gathered(8).depth) == 0


def test_a_map_that_was_adjusted_in_millimetres_has_its_own_unit(sensor):
    found = sensor_scale(submap(), sensor)
    adjusted = found.in_unit_of([3.0, 1.003 * found.mm_per_unit])
    assert adjusted.mm_per_unit == 1.003 * found.mm_per_unit
    assert f"{found.mm_per_unit:.4g} by the median of" in str(adjusted)
    assert found.in_unit_of([3.0, 1.02 * found.mm_per_unit]) == found
    assert found.in_unit_of([]) == found
