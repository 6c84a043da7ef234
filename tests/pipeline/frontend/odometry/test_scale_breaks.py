"""A tracked map is cut where its scale breaks, and nowhere else."""

import numpy as np
import pytest

from haustra.core.camera import Camera
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import ray_table
from haustra.core.se3 import in_camera
from pipeline.frontend.odometry.front_end import cut_at_breaks
from pipeline.frontend.odometry.scale_breaks import shares_at_two_depths
from pipeline.mapping.local_map import LocalMap

KEYFRAMES, STEP, BORN, LIFE = 40, 0.05, 60, 8  # tracks that begin in each keyframe, and keyframes that see them
RAYS = ray_table(Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0)))


class Recorded(SilentProgress):
    def __init__(self) -> None:
        self.lines: list[str] = []

    def log(self, sentence: str) -> None:
        self.lines.append(sentence)


def sliding_map(breaks: dict[int, float], outliers: float = 0.0) -> LocalMap:
    """A camera slides along a wall. From keyframe b of `breaks` on the map's unit is larger by the factor given for it:
    what comes new is that much nearer, what was mapped before stays. outliers: share of points at a wrong depth."""
    rng = np.random.default_rng(5)
    local_map, scale, centre = LocalMap(RAYS), 1.0, np.zeros(3)
    local_map.tracks.reserve(KEYFRAMES * BORN)
    centres, points = [], np.zeros((KEYFRAMES * BORN, 3))
    for number in range(KEYFRAMES):
        scale *= breaks.get(number, 1.0)
        centres.append(centre.copy())
        local = np.column_stack([rng.uniform(-1.4, 1.4, (BORN, 2)), rng.uniform(1.8, 2.2, BORN)])
        local[rng.uniform(size=BORN) < outliers] *= 2.0
        points[number * BORN : (number + 1) * BORN] = centre + scale * local
        centre = centre + np.array([scale * STEP, 0, 0])
    for number in range(KEYFRAMES):
        camera_from_world = np.eye(4)
        camera_from_world[:3, 3] = -centres[number]
        ids = np.arange(max(0, number - LIFE + 1) * BORN, (number + 1) * BORN)
        pixels = RAYS.project(in_camera(camera_from_world, points[ids]))
        inside = np.isfinite(pixels).all(axis=1) & (pixels > 0).all(axis=1) & (pixels < 320).all(axis=1)
        local_map.add_keyframe(2 * number, camera_from_world, ids[inside], pixels[inside])
        local_map.add_tracked_frame(2 * number + 1, camera_from_world, ids[inside], pixels[inside])
    local_map.tracks.points[: len(points)], local_map.tracks.has_point[: len(points)] = points, True
    return local_map


@pytest.mark.parametrize("factor", [0.3, 0.5, 2.5])
def test_a_map_is_cut_where_its_scale_breaks(factor: float) -> None:
    progress = Recorded()
    parts = cut_at_breaks([sliding_map({20: factor}, outliers=0.03)], progress)
    assert len(parts) == 2
    begun = parts[1].keyframes[0].frame // 2
    assert 20 <= begun <= 20 + LIFE
    assert [len(part.keyframes) for part in parts] == [begun, KEYFRAMES - begun]
    assert sorted(set.union(*(part.frames for part in parts))) == list(range(2 * KEYFRAMES))
    assert not parts[0].frames & parts[1].frames
    assert all(0 <= tracked.keyframe < len(part.keyframes) for part in parts for tracked in part.tracked_frames)
    assert any(f"frame {2 * begun}:" in line for line in progress.lines)


def test_each_part_has_one_scale() -> None:
    """Up to the last keyframe before the cut and from the first one behind it, which both see points of both scales."""
    for part, distance in zip(cut_at_breaks([sliding_map({20: 0.3})], Recorded()), (2.0, 0.6), strict=True):
        views = [part.sparse_view(keyframe) for keyframe in part.keyframes]
        assert np.nanmax(shares_at_two_depths(views)) < 0.1
        assert all(view.points[:, 2] == pytest.approx(distance, rel=0.15) for view in views)


def test_each_point_goes_to_one_part() -> None:
    whole = sliding_map({20: 0.3}, outliers=0.03)
    seen = [set(np.flatnonzero(part.incidence().sum(axis=0))) for part in cut_at_breaks([whole], Recorded())]
    assert not seen[0] & seen[1]
    assert seen[0] | seen[1] == set(np.flatnonzero(whole.incidence().sum(axis=0)))


def test_two_breaks_make_three_parts() -> None:
    assert len(cut_at_breaks([sliding_map({14: 0.4, 27: 0.4})], Recorded())) == 3


@pytest.mark.parametrize("outliers", [0.0, 0.1])
@pytest.mark.parametrize("breaks", [{}, {20: 0.95}, {2: 0.3}])
def test_a_map_of_one_scale_is_not_cut(breaks: dict[int, float], outliers: float) -> None:
    """Nor is it where hardly anything would be cut off, or for outliers that are everywhere."""
    whole = sliding_map(breaks, outliers)
    progress = Recorded()
    assert cut_at_breaks([whole], progress) == [whole]
    assert progress.lines == []


def test_a_gradual_drift_is_not_cut() -> None:
    """It is taken back by the last adjustment."""
    assert len(cut_at_breaks([sliding_map(dict.fromkeys(range(1, KEYFRAMES), 0.97))], Recorded())) == 1


def test_a_short_map_stays() -> None:
    short = sliding_map({7: 0.3})
    short.keyframes = short.keyframes[:14]
    assert cut_at_breaks([short], Recorded()) == [short]
