"""Submaps of one tube, adjusted to their features and joined where they saw the same."""

import copy

import numpy as np
import pytest

from haustra.core.progress import SilentProgress
from pipeline.mapping import final_adjustment, submap_merging
from pipeline.mapping.final_adjustment import adjust_maps_to_features
from pipeline.mapping.local_map import TrackKind
from pipeline.mapping.submap_merging import Merged, merge_maps
from pipeline.mapping.submap_of_map import to_submap
from pipeline.matching.sift_cache import SiftCache
from reconstruction.evaluation.trajectory_metrics import trajectory_errors
from tests.helpers.tubes import textured_tube
from tests.helpers.tubes.textured_tube import CAMERA, MASK, camera_at, polished, render, run, wall_texture


@pytest.fixture(scope="module")
def clip():
    poses = [camera_at(k) for k in range(26)]
    return [render(world_from_camera) for world_from_camera in poses], np.stack(poses)


@pytest.fixture(scope="module")
def there_and_back(clip):
    """Black frames, then the way back: two maps that are adjusted to their features, and what held them."""
    images = clip[0][:26] + [np.zeros_like(clip[0][0])] * 12 + clip[0][25:8:-1]
    order = [*range(26), *[-1] * 12, *range(25, 8, -1)]
    maps, states = run(images)
    assert "lost" in states
    assert len(maps) == 2

    def read(number):
        return images[number], MASK

    find = SiftCache(read)
    return maps, adjust_maps_to_features(polished(maps), find, SilentProgress()), find, order


def test_a_place_seen_again_joins_two_maps(clip, there_and_back):
    maps, held, find, order = there_and_back
    assert None not in held
    (joined,), joins = submap_merging.merge_and_adjust(copy.deepcopy(maps), held, find, 0, SilentProgress())
    assert joins == 1
    numbers = [int(k.ids.max()) for k in joined.keyframes]
    assert max(numbers) < len(joined.tracks)
    submap = to_submap(joined, CAMERA.params)
    followed = submap.is_klt
    assert min(followed.sum(), (~followed).sum()) > 500, "features of the joined map and followed corners"
    truth = clip[1][[order[k] for k in submap.frames]]
    assert submap.frames[-1] > 38 > submap.frames[0]
    assert trajectory_errors(submap.world_from_camera, truth).ate_rmse < 0.2
    seam = len(maps[0].keyframes)
    shared = [len(np.intersect1d(a.ids, b.ids)) for a in joined.keyframes[:seam] for b in joined.keyframes[seam:]]
    assert max(shared) > 50, "features across the seam"


def test_a_merged_map_knows_how_its_tracks_were_found(there_and_back):
    maps, _, find, _ = there_and_back
    corners = [{id(k): set(k.ids[m.tracks.is_kind(TrackKind.KLT)[k.ids]]) for k in m.keyframes} for m in maps]
    (merged,) = merge_maps(copy.deepcopy(maps), find, 0)
    tracks, of_map = merged.map.tracks, [len(m.keyframes) for m in maps]
    seen = [tracks.kind[keyframe.ids] for keyframe in merged.map.keyframes]
    assert not np.isin(np.concatenate(seen), (TrackKind.FEATURE, TrackKind.WIDE_FEATURE)).any(), "matched again later"
    counts = [
        sum(int((kind == TrackKind.KLT).sum()) for kind in part) for part in (seen[: of_map[0]], seen[of_map[0] :])
    ]
    assert counts == [sum(map(len, by.values())) for by in corners], "corners of both maps stay what they were"
    for part in (seen[: of_map[0]], seen[of_map[0] :]):
        assert sum(int((kind == TrackKind.MERGE).sum()) for kind in part) > 50, "matches across the seam"
    merged.map.forget_features()
    assert not merged.map.tracks.is_kind(TrackKind.FEATURE, TrackKind.WIDE_FEATURE).any()


def test_a_join_that_features_do_not_hold_is_undone(there_and_back, monkeypatch):
    maps, held, find, _ = there_and_back
    poses = [[k.camera_from_world.copy() for k in m.keyframes] for m in maps]
    together = Merged(copy.deepcopy(maps[0]), (0, 1))
    monkeypatch.setattr(submap_merging, "merge_maps", lambda *_: [together])
    for outcome in (None, np.inf):
        monkeypatch.setattr(final_adjustment, "adjust_to_features", lambda *_, outcome=outcome: outcome)
        kept, joins = submap_merging.merge_and_adjust(copy.deepcopy(maps), held, find, 0, SilentProgress())
        assert joins == 0
        for local_map, before in zip(kept, poses, strict=True):
            np.testing.assert_array_equal([k.camera_from_world for k in local_map.keyframes], before)
            features = local_map.tracks.is_kind(TrackKind.FEATURE)
            assert any(features[k.ids].any() for k in local_map.keyframes), "with their features"
    monkeypatch.setattr(final_adjustment, "adjust_to_features", lambda *_: held[0])
    assert submap_merging.merge_and_adjust(copy.deepcopy(maps), held, find, 0, SilentProgress()) == ([together.map], 1)


def test_other_places_are_not_joined(clip, monkeypatch):
    """The same tube with another wall: nothing in common but its shape."""
    maps, _ = run(clip[0][:20])
    monkeypatch.setattr(textured_tube, "TEXTURE", wall_texture(seed=9))
    others = [render(camera_at(k)) for k in range(20)]
    more, _ = run(others)
    images = {id(maps[0]): clip[0], id(more[0]): others}
    for local_map in more:
        for keyframe in local_map.keyframes:
            keyframe.frame += 1000

    def read(k):
        return (images[id(more[0])][k - 1000] if k >= 1000 else images[id(maps[0])][k]), MASK

    assert [whole.members for whole in merge_maps(polished(maps + more), SiftCache(read), 0)] == [(0,), (1,)]
