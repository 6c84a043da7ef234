"""The second pass by neighbours' pictures, in a tube whose depth is known exactly and whose first depths are wrong."""

import itertools
import shutil
from contextlib import nullcontext
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from completion.confidence import confidence_from_error
from completion.inference.kriging import towards_points
from haustra.core.progress import SilentProgress
from pipeline.config import DepthSettings
from pipeline.depth import multiview_stage
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import DiskKeyframes, depth_on_disk
from pipeline.depth.multiview_stage import has_second_pass, refine_depth
from pipeline.depth.rectification import make_rectifier
from pipeline.depth.sensor.joined_points import NOTHING
from pipeline.depth.sparse_depth import SparseDepthMaker
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace
from tests.helpers.tubes.textured_tube import CAMERA, RADIUS, SIZE, camera_at, render, stored
from tests.helpers.tubes.textured_tube import true_depth as depth_in_mm

COUNT = 9
SPREAD = 0.03  # of log depth that is wrong, otherwise in each keyframe
CONFIDENCE = np.full((SIZE, SIZE), confidence_from_error(np.float32(SPREAD)), np.float32)


POSES = np.stack([camera_at(2 * k) for k in range(COUNT)])  # of the pictures
POSES_IN_RADII = POSES.copy()
POSES_IN_RADII[:, :3, 3] /= RADIUS


def unwanted(*_):
    raise AssertionError("nothing is asked of it")


def true_depth(k):
    """(H,W) in radii, the scene's unit."""
    return depth_in_mm(POSES[k]) / np.float32(RADIUS)


def wrong(k):
    """(H,W) of log depth: waves as wide as a third of the picture."""
    x, y = np.meshgrid(np.arange(SIZE), np.arange(SIZE))
    return SPREAD * np.sin(x / 15 + 2.1 * k) * np.cos(y / 18 + 1.3 * k)


def first_depth(k):
    return (true_depth(k) * np.exp(wrong(k))).astype(np.float32)


def few_points(pixels_apart=60):
    """Points of the wall and who sees them: (P,3), (M,2), (M,2)."""
    points = []
    for k in range(0, COUNT, 3):
        pose, depth = POSES_IN_RADII[k], true_depth(k)
        y, x = (part.ravel() for part in np.mgrid[20:SIZE:pixels_apart, 20:SIZE:pixels_apart])
        known = depth[y, x] > 0
        plane, _ = CAMERA.unproject(np.column_stack([x, y])[known] + 0.5)
        local = np.column_stack([plane, np.ones(len(plane))]) * depth[y, x][known, None]
        points.append(local @ pose[:3, :3].T + pose[:3, 3])
    world = np.concatenate(points)
    seen, pixels = [], []
    for row, pose in enumerate(POSES_IN_RADII):
        local = (world - pose[:3, 3]) @ pose[:3, :3]
        at = CAMERA.project(local)
        inside = (local[:, 2] > 0.05) & (at > 0).all(axis=1) & (at < SIZE).all(axis=1)
        seen += [(row, int(point)) for point in np.flatnonzero(inside)]
        pixels.append(at[inside])
    return world, np.array(seen), np.concatenate(pixels)


@pytest.fixture(scope="module")
def begun(tmp_path_factory):
    """A run folder with first depths, its frames and its submap."""
    workspace, frames = stored(tmp_path_factory.mktemp("photometric"), [render(pose) for pose in POSES])
    first = DiskKeyframes(workspace, first=True)
    for k in range(COUNT):
        first.write_depth(k, first_depth(k), CONFIDENCE)
    world, seen, pixels = few_points()
    submap = Submap(np.arange(COUNT), POSES_IN_RADII, world, np.full(len(world), 0.3), seen, pixels, CAMERA.params)
    return workspace.root, frames, submap


@pytest.fixture
def copied(begun, tmp_path):
    root, frames, submap = begun
    shutil.copytree(root, tmp_path / "run")
    return Workspace(tmp_path / "run"), frames, submap


def refined(copied, completer=unwanted, **settings):
    workspace, frames, submap = copied
    completed = CompletedSubmap(submap, make_rectifier(CAMERA), np.arange(COUNT), depth_on_disk(workspace))
    return refine_depth(frames, [completed], completer, DepthSettings(**settings), workspace, SilentProgress())[0]


def depths(completed):
    return np.stack([completed.depth(row)[0] for row in range(COUNT)])


def test_depth_gets_nearer_to_the_wall_and_confidence_stays(copied):
    after = refined(copied)
    for row, depth in enumerate(depths(after)):
        truth = true_depth(row)
        known = (truth > 0) & (depth > 0)
        off = np.abs(np.log(depth[known] / truth[known]))
        assert np.median(off) < 0.5 * np.median(np.abs(wrong(row)[known]))
    np.testing.assert_allclose(after.depth(0)[1], CONFIDENCE, atol=1 / 255)
    assert not copied[0].first_depth.exists()


def test_a_stopped_run_and_one_of_a_single_thread_end_at_the_same_bytes(copied, tmp_path, monkeypatch):
    other = Workspace(tmp_path / "other")
    shutil.copytree(copied[0].root, other.root)
    at_once = refined(copied)
    monkeypatch.setattr(multiview_stage, "workers", lambda: 1)
    made, calls = multiview_stage.photometric_points, itertools.count(1)

    def stopping(*arguments):
        if next(calls) == 4:
            raise KeyboardInterrupt
        return made(*arguments)

    monkeypatch.setattr(multiview_stage, "photometric_points", stopping)
    with pytest.raises(KeyboardInterrupt):
        refined((other, *copied[1:]))
    assert other.first_depth.exists()
    gone_on = refined((other, *copied[1:]))
    np.testing.assert_array_equal(depths(gone_on), depths(at_once))


def test_without_it_first_depths_that_are_left_are_corrected_by_their_points_alone(copied, monkeypatch):
    workspace, _, submap = copied
    monkeypatch.setattr(multiview_stage, "photometric_points", unwanted)
    found, maker = depths(refined(copied, photometric=False)), SparseDepthMaker(submap, CAMERA)
    expected = np.full((SIZE, SIZE), SPREAD, np.float32)
    for k, depth in enumerate(found):
        own = maker.sparse_depth(k).maps(SIZE, SIZE)
        np.testing.assert_allclose(depth, towards_points(first_depth(k), expected, *own), atol=1e-3)
    assert not workspace.first_depth.exists()


def test_a_finished_run_of_a_version_without_it_keeps_its_depth(copied):
    workspace, _, _ = copied
    shutil.rmtree(workspace.first_depth)
    latest = DiskKeyframes(workspace)
    for k in range(COUNT):
        latest.write_depth(k, first_depth(k), CONFIDENCE)
    before = {path: path.read_bytes() for path in workspace.depth.iterdir()}
    refined(copied)
    assert {path: path.read_bytes() for path in workspace.depth.iterdir()} == before


def a_sensor(points):
    return SimpleNamespace(settings=SimpleNamespace(points=points))


@pytest.mark.parametrize(
    ("settings", "sensor", "expected"),
    [
        ({}, None, True),
        ({}, a_sensor("gathered"), False),
        ({}, a_sensor("none"), True),
        ({"photometric": False}, None, False),
        ({"photometric": False}, a_sensor("none"), False),
        ({"photometric": False, "multiview": True}, None, True),
        ({"multiview": True}, a_sensor("gathered"), True),
    ],
)
def test_depth_that_nothing_refines_has_no_second_pass(settings, sensor, expected):
    """Where a sensor's points are used, no patches are: its keyframes are corrected when they are completed."""
    assert has_second_pass(DepthSettings(**settings), sensor) is expected


def test_no_patch_is_asked_where_a_sensor_measured_depth(copied, monkeypatch):
    """As in a run that an earlier version left stopped before its second pass."""
    monkeypatch.setattr(multiview_stage, "open_sensor", lambda *_: a_sensor("gathered"))
    monkeypatch.setattr(multiview_stage, "points_of", lambda *_: lambda _: NOTHING)
    monkeypatch.setattr(multiview_stage, "photometric_points", unwanted)
    before = [first_depth(k) for k in range(COUNT)]
    np.testing.assert_allclose(depths(refined(copied)), before, atol=1e-3)


def test_no_patch_is_asked_where_own_points_say_that_the_wall_moved(copied, monkeypatch):
    maker = SparseDepthMaker(copied[-1], CAMERA)

    def moved(row):
        points = maker.sparse_depth(row)
        return replace(points, depth=points.depth * np.where(np.arange(len(points.depth)) % 2, 0.8, 1.25))

    monkeypatch.setattr(multiview_stage, "points_of", lambda *_: moved)
    monkeypatch.setattr(multiview_stage, "photometric_points", unwanted)
    before = [first_depth(k) for k in range(COUNT)]
    np.testing.assert_allclose(depths(refined(copied)), before, atol=1e-3)


def test_own_points_correct_first_and_stay_among_the_photometric_ones(copied, monkeypatch):
    calls, views = [], []
    made = multiview_stage.photometric_points

    def corrected(depth, expected, sparse, error, *more, **named):
        found = towards_points(depth, expected, sparse, error, *more, **named)
        calls.append((depth, sparse, error, found, (*more, *named.values())))
        return found

    monkeypatch.setattr(multiview_stage, "workers", lambda: 1)
    monkeypatch.setattr(multiview_stage, "towards_points", corrected)
    monkeypatch.setattr(multiview_stage, "photometric_points", lambda *a: (views.append(a[0]), made(*a))[1])
    refined(copied)
    assert len(calls) == 2 * len(views) == 2 * COUNT
    for (first, own, told, once, (share,)), (again, both, errors, _, (_, same)) in zip(*[iter(calls)] * 2, strict=True):
        assert share == same == 1
        np.testing.assert_array_equal(both[own > 0], own[own > 0])
        np.testing.assert_array_equal(errors[own > 0], told[own > 0])
        assert np.count_nonzero(both) > np.count_nonzero(own) + 100
        np.testing.assert_array_equal(again, once)
        assert not np.array_equal(once, first)
    for view, call in zip(views, calls[::2], strict=True):
        np.testing.assert_array_equal(view.depth, call[3])


def test_patches_are_asked_after_a_network_has_refined(copied, monkeypatch):
    class Farther:
        can_refine, at_once, working_side_by_side = True, 1, nullcontext

        def refine(self, rgb, sparse, error, depth, confidence):
            return 1.004 * depth, confidence

    made, views = multiview_stage.photometric_points, []
    monkeypatch.setattr(multiview_stage, "photometric_points", lambda *a: (views.append(a[0]), made(*a))[1])
    after = depths(refined(copied, Farther, multiview=True))
    assert len(views) == COUNT
    for row, depth in enumerate(after):
        known = (true_depth(row) > 0) & (depth > 0)
        off = np.abs(np.log(depth[known] / true_depth(row)[known]))
        assert np.median(off) < 0.6 * np.median(np.abs(wrong(row)[known]))
