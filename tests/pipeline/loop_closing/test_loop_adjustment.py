"""The adjustment of closed loops: exact features on a circle take back a bend that no loop shows."""

from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.sim3 import scale_of
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.loop_closing.detection import LoopClosure, SubmapFeatures
from pipeline.loop_closing.keyframe_pose_graph import LoopClosingResult, deform, nodes_of
from pipeline.loop_closing.loop_adjustment import (
    adjust_loops,
    adjust_nodes,
    feature_tracks,
    is_held,
    match_keyframes,
    well_constrained,
)
from pipeline.mapping.submap import Submap
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sim3_match import Sim3Match
from pipeline.run_folder.workspace import Workspace
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.pose_circle import circle, exponential

CAMERA = Camera("PINHOLE", 320, 320, (200.0, 200.0, 160.0, 160.0))
COUNT = 40
BEND = 0.15  # log scale halfway round; nothing at the ends, so that the loop holds


def bent() -> np.ndarray:
    """The circle as a map whose scale grows on the way out and shrinks on the way back has it: nodes in Sim(3)."""
    true, growth = circle(COUNT), BEND * np.sin(np.pi * np.arange(COUNT) / (COUNT - 1))
    nodes = [true[0]]
    for k, (here, there) in enumerate(pairwise(true)):
        nodes.append(nodes[-1] @ np.linalg.inv(here) @ there @ exponential((growth[k + 1] - growth[k]) * np.eye(7)[6]))
    return np.stack(nodes)


@cache
def seen() -> tuple[CompletedSubmap, list[KeyframeFeatures], Sim3Match]:
    """The bent map's keyframes, each with the true pixels of what it sees; one link from the end to the start."""
    rng, true, nodes = np.random.default_rng(0), circle(COUNT), bent()
    cloud = rng.uniform([-6, -1.5, -6], [6, 1.5, 6], (1400, 3))
    names = rng.integers(0, 256, (len(cloud), 128), np.uint8)
    places, ids = [], []
    for row, world_from_camera in enumerate(true):
        local = (cloud - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        near = np.flatnonzero((local[:, 2] > 0.5) & (local[:, 2] < 3))
        pixels = CAMERA.project(local[near])
        inside = ((pixels > 0) & (pixels < 320)).all(axis=1)
        ids.append(near[inside])
        points = local[ids[-1]] * scale_of(nodes[row])
        flags = np.zeros(len(points), bool)
        places.append(KeyframeFeatures(row, pixels[inside], names[ids[-1]], points, flags + 4.0, flags))
    poses = nodes.copy()
    poses[:, :3, :3] /= scale_of(nodes)[:, None, None]
    nothing = np.zeros((0, 2))
    submap = Submap(
        np.arange(COUNT), poses, np.zeros((0, 3)), np.zeros(0), nothing.astype(np.int64), nothing, CAMERA.params
    )
    completed = CompletedSubmap(
        submap, make_rectifier(CAMERA, 120), np.arange(COUNT), DiskKeyframes(Workspace(Path("unused")))
    )
    rows = np.intersect1d(ids[0], ids[-1], return_indices=True)[1:]
    return completed, places, Sim3Match(0, COUNT - 1, np.eye(4), np.column_stack(rows))


def ate(poses: np.ndarray, number: np.ndarray | None = None) -> float:
    true = circle(COUNT)
    return trajectory_errors(poses, true if number is None else true[number]).ate_rmse


def rigid(nodes: np.ndarray) -> np.ndarray:
    poses = nodes.copy()
    poses[:, :3, :3] /= scale_of(nodes)[:, None, None]
    return poses


@pytest.fixture(autouse=True)
def few_features_suffice(monkeypatch):
    """Few are enough here: they are exact."""
    monkeypatch.setattr("pipeline.loop_closing.loop_adjustment.MIN_TYPICAL_FEATURES", 30)


def test_a_bend_that_no_loop_shows_is_taken_back():
    completed, places, link = seen()
    assert link.inliers > 10
    before = ate(completed.submap.world_from_camera)
    number, nodes = adjust_nodes(completed, places, [link], completed.submap.world_from_camera)
    assert number.tolist() == list(range(COUNT))
    assert before > 0.05
    assert ate(rigid(nodes)) < before / 50
    scale = scale_of(nodes) * scale_of(bent())
    np.testing.assert_allclose(scale / scale[0], 1, rtol=0.01)  # each keyframe's own unit, in that of the map


def test_two_runs_agree_to_the_bit():
    completed, places, link = seen()
    runs = [adjust_nodes(completed, places, [link], completed.submap.world_from_camera) for _ in range(2)]
    assert all(np.array_equal(one, other) for one, other in zip(*runs, strict=True))


def test_false_matches_are_left_out():
    completed, places, link = seen()
    rng = np.random.default_rng(1)
    rows = rng.integers(0, [[len(places[0].pixels)], [len(places[-1].pixels)]], (2, 8))
    lies = replace(link, rows=rows.T)
    _, nodes = adjust_nodes(completed, places, [link, lies], completed.submap.world_from_camera)
    assert ate(rigid(nodes)) < ate(completed.submap.world_from_camera) / 10


@pytest.mark.parametrize("narrow_suffice", [True, False])
def test_wide_features_have_a_say_only_where_narrow_ones_are_too_few(monkeypatch, narrow_suffice):
    """A quarter of the features, 30 px wide, lie a hundredth too far out in every picture, as by another lens."""
    completed, places, link = seen()
    if not narrow_suffice:
        monkeypatch.setattr(
            "pipeline.loop_closing.loop_adjustment.MIN_TYPICAL_FEATURES",
            np.median([len(place.points) for place in places]) * 0.8,
        )
    spoilt = []
    for place in places:
        wide = place.descriptors[:, 0] < 64  # the same ones everywhere
        points = np.where(wide[:, None], place.points * [1.01, 1.01, 1.0], place.points)
        spoilt.append(replace(place, points=points, sizes=np.where(wide, 30.0, 4.0)))
    _, nodes = adjust_nodes(completed, spoilt, [link], completed.submap.world_from_camera)
    without = ate(rigid(adjust_nodes(completed, places, [link], completed.submap.world_from_camera)[1]))
    assert (ate(rigid(nodes)) < 2 * without + 1e-4) == narrow_suffice


def test_a_keyframe_without_features_follows_its_neighbours():
    completed, places, link = seen()
    blind = [place if k != 11 else empty(place) for k, place in enumerate(places)]
    number, nodes = adjust_nodes(completed, blind, [link], completed.submap.world_from_camera)
    assert number.tolist() == [k for k in range(COUNT) if k != 11]
    followed = deform(completed, completed.rows[number], nodes)
    assert ate(followed.submap.world_from_camera) < ate(completed.submap.world_from_camera) / 20


def test_a_stretch_without_features_is_not_adjusted():
    completed, places, link = seen()
    blind = [empty(place) if k in range(10, 20) else place for k, place in enumerate(places)]
    assert adjust_nodes(completed, blind, [link], completed.submap.world_from_camera) is None


def test_few_may_follow_at_the_ends(monkeypatch):
    completed, places, _ = seen()
    tracks = feature_tracks(places, match_keyframes(completed, places, []), completed.submap.world_from_camera)
    assert well_constrained(tracks, COUNT).tolist() == list(range(COUNT))
    assert is_held(tracks, np.arange(COUNT - 4), COUNT)
    assert not is_held(tracks, np.arange(COUNT - 7), COUNT)
    monkeypatch.setattr("pipeline.loop_closing.loop_adjustment.MIN_TYPICAL_FEATURES", 1000)
    assert not is_held(tracks, np.arange(COUNT), COUNT)


def test_two_features_of_one_picture_are_not_one_point():
    completed, places, link = seen()
    twice = replace(link, rows=np.array([[0, 0], [1, 0]]))
    tracks = feature_tracks(places, match_keyframes(completed, places, [twice]), completed.submap.world_from_camera)
    assert len(np.unique(np.column_stack([tracks.track, tracks.place]), axis=0)) == len(tracks.track)
    assert (np.bincount(tracks.track) >= 2).all()


def test_links_between_places_are_those_of_keyframes(monkeypatch):
    """The graph looks at some keyframes only; the bundle at all."""
    completed, places, link = seen()
    everything = SubmapFeatures(completed, places, RayTable(CAMERA))
    monkeypatch.setattr("pipeline.loop_closing.loop_adjustment.features_of_all", lambda *_: everything)
    some = SubmapFeatures(completed, [places[0], places[20], places[-1]], RayTable(CAMERA))
    loop = LoopClosure(replace(link, second=2), np.eye(7))
    closed = LoopClosingResult(completed, 1, 1, (loop,), ((0, COUNT - 1),))
    adjusted = adjust_loops(some, closed)
    expected = adjust_nodes(completed, places, [link], nodes_of(completed, completed))[1]
    np.testing.assert_allclose(nodes_of(completed, adjusted), expected, atol=1e-9)


def empty(place: KeyframeFeatures) -> KeyframeFeatures:
    return KeyframeFeatures.none(place.keyframe)
