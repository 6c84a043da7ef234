"""Votes between posed depth maps, against scenes whose depth is known in closed form."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from pipeline.config import ConsistencySettings
from pipeline.surface.depth_filter import DepthFilter
from reconstruction.fusion.depth_consistency import DepthView, agreement

SIZE = 96
INTRINSICS = np.array([[70.0, 0, SIZE / 2], [0, 70.0, SIZE / 2], [0, 0, 1]])
RADIUS = 20.0


def transform(seed: int) -> np.ndarray:
    """A camera near the middle of the sphere, looking roughly along z."""
    rng = np.random.default_rng(seed)
    matrix = np.eye(4)
    matrix[:3, :3] = Rotation.from_rotvec(rng.normal(0, 0.15, 3)).as_matrix()
    matrix[:3, 3] = rng.normal(0, 2.5, 3)
    return matrix


def rays(world_from_camera: np.ndarray) -> np.ndarray:
    """(H,W,3) directions in the world whose camera z is 1, so that depth is the distance along them."""
    y, x = np.mgrid[:SIZE, :SIZE] + 0.5
    directions = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(INTRINSICS).T
    return directions @ world_from_camera[:3, :3].T


def sphere_depth(world_from_camera: np.ndarray) -> np.ndarray:
    """z-depth of the inside of a sphere about the origin."""
    d, o = rays(world_from_camera), world_from_camera[:3, 3]
    a, b, c = (d**2).sum(-1), d @ o, o @ o - RADIUS**2
    return (-b + np.sqrt(b**2 - a * c)) / a


def fold_depth(world_from_camera: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """The depth, with a wall at z = 8 before half of the sphere (x > 1)."""
    d, o = rays(world_from_camera), world_from_camera[:3, 3]
    along = (8 - o[2]) / d[..., 2]
    hit = (along > 0) & (o[0] + along * d[..., 0] > 1) & (along < depth)
    return np.where(hit, along, depth)


def views(count: int, fold: bool = False) -> list[DepthView]:
    found = []
    for seed in range(count):
        depth = sphere_depth(transform(seed))
        depth = fold_depth(transform(seed), depth) if fold else depth
        found.append(DepthView(depth.astype(np.float32), INTRINSICS, transform(seed)))
    return found


@pytest.mark.parametrize("fold", [False, True])
def test_frames_of_one_scene_support_each_other_also_where_a_fold_hides_the_wall(fold: bool) -> None:
    first, *others = views(6, fold)
    votes = agreement(first, others, tolerance=0.03, stride=1)
    assert votes.judged.mean() > 0.8
    assert votes.contradicted_share < 0.005
    assert (votes.confidence_factor(severity=2.0)[~votes.judged] == 1).all()
    assert votes.supports.max() == 5


def test_a_wrong_frame_and_a_wrong_patch_are_contradicted_and_nothing_else() -> None:
    first, *others = views(6)
    for factor in (0.8, 1.25):
        wrong = DepthView(np.float32(factor) * first.depth, INTRINSICS, first.world_from_camera)
        votes = agreement(wrong, others, tolerance=0.05)
        assert votes.contradicted_share > 0.95
        assert votes.confidence_factor(severity=2.0)[votes.judged].mean() < 0.3
    patched = first.depth.copy()
    patched[30:50, 30:50] *= 1.3
    votes = agreement(DepthView(patched, INTRINSICS, first.world_from_camera), others, tolerance=0.05, stride=1)
    inside = np.zeros((SIZE, SIZE), bool)
    inside[31:49, 31:49] = True
    outvoted = votes.contradictions > votes.supports
    assert outvoted[inside].mean() > 0.95
    assert outvoted[:28].mean() < 0.01


def test_one_wrong_frame_among_many_changes_no_good_one() -> None:
    first, second, *others = views(6)
    liar = DepthView(0.7 * second.depth, INTRINSICS, second.world_from_camera)
    votes = agreement(first, [liar, *others], tolerance=0.05)
    assert votes.contradicted_share < 0.02


def test_unknown_depth_has_no_vote_and_scale_does_not_matter() -> None:
    first, *others = views(4)
    blank = [DepthView(np.zeros_like(o.depth), INTRINSICS, o.world_from_camera) for o in others]
    assert not agreement(first, blank, tolerance=0.05).judged.any()
    holed = first.depth.copy()
    holed[:20] = 0
    votes = agreement(DepthView(holed, INTRINSICS, first.world_from_camera), others, tolerance=0.05)
    assert not votes.judged[:20].any()

    def scaled(view: DepthView) -> DepthView:
        moved = view.world_from_camera.copy()
        moved[:3, 3] *= 40
        return DepthView(40 * view.depth, INTRINSICS, moved)

    plain = agreement(first, others, 0.05)
    other = agreement(scaled(first), [scaled(o) for o in others], 0.05)
    assert (plain.supports != other.supports).mean() < 0.01


def voted(view: DepthView, other: DepthView, tolerance: float) -> tuple[np.ndarray, np.ndarray]:
    """(supports, contradictions) of one other frame, with matrices, as the module's docstring has it."""

    def carried(rows, columns, depth, source, target):
        pixel = np.stack([columns + 0.5, rows + 0.5, np.ones(rows.shape)])
        local = np.linalg.inv(INTRINSICS) @ pixel.reshape(3, -1) * depth.ravel()
        world = source.world_from_camera[:3, :3] @ local + source.world_from_camera[:3, 3:]
        back = np.linalg.inv(target.world_from_camera)
        there = INTRINSICS @ (back[:3, :3] @ world + back[:3, 3:])
        z = np.where(np.isfinite(there[2]), there[2], -1)
        column, row = np.floor(np.nan_to_num(there[:2] / np.where(z > 1e-9, z, 1), nan=-1)).astype(int)
        inside = (z > 1e-9) & (column >= 0) & (row >= 0) & (column < SIZE) & (row < SIZE)
        return (a.reshape(rows.shape) for a in (z, np.where(inside, row, 0), np.where(inside, column, 0), inside))

    rows, columns = np.mgrid[:SIZE, :SIZE]
    z, row, column, inside = carried(rows, columns, view.depth, view, other)
    near, far = (extreme[row, column] for extreme in other.extremes)
    judged = (view.depth > 0) & inside & (near > 0)
    through, behind = judged & (z < near * (1 - tolerance)), judged & (z > far * (1 + tolerance))
    back, at_row, at_column, within = carried(row, column, other.depth[row, column], other, view)
    own = view.extremes[0][at_row, at_column]
    looked_through = behind & within & (own > 0) & (back < own * (1 - tolerance))
    return judged & ~through & ~behind, through | looked_through


@pytest.mark.parametrize("fold", [False, True])
def test_votes_are_those_of_matrices(fold: bool) -> None:
    """Noise, holes and values that are no depth; a pixel's share may fall on the other side by rounding."""
    rng = np.random.default_rng(3)
    frames = views(4, fold)
    for frame in frames:
        frame.depth[:] *= np.exp(rng.normal(0, 0.03, frame.depth.shape)).astype(np.float32)
        frame.depth[rng.random(frame.depth.shape) < 0.01] = 0
    frames[0].depth[20:50] *= 0.8
    frames[0].depth[60:80] *= 1.2
    frames[0].depth[rng.random((SIZE, SIZE)) < 0.01] = np.nan
    frames[0].depth[rng.random((SIZE, SIZE)) < 0.01] = -1
    votes = agreement(frames[0], frames[1:], tolerance=0.03, stride=1)
    expected = np.sum([voted(frames[0], other, 0.03) for other in frames[1:]], axis=0)
    assert expected[0].sum() > 1000
    assert expected[1].sum() > 1000
    assert (votes.supports != expected[0]).mean() < 1e-3
    assert (votes.contradictions != expected[1]).mean() < 1e-3


class Keyframes:
    """As much of a `CompletedSubmap` as the check looks at."""

    def __init__(self, frames: list[DepthView]) -> None:
        self.frames, self.rows = frames, np.arange(len(frames))
        self.camera = SimpleNamespace(matrix=INTRINSICS)
        self.confidences: dict[int, np.ndarray] = {}  # of some rows; 0.8 elsewhere

    def __len__(self) -> int:
        return len(self.frames)

    def depth(self, row: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        frame = self.frames[row]
        confidence = self.confidences.get(row, np.full((SIZE, SIZE), 0.8, np.float32))
        return frame.depth, confidence, frame.world_from_camera


def test_a_keyframe_with_a_wild_pose_is_left_out_and_its_neighbours_stay() -> None:
    frames = views(12)
    wild = frames[6].world_from_camera.copy()
    wild[:3, 3] += [4, 3, -6]
    frames[6] = DepthView(frames[6].depth, INTRINSICS, wild)
    check = DepthFilter(Keyframes(frames), ConsistencySettings(), 0.1)  # type: ignore[arg-type]
    sure = np.full((SIZE, SIZE), 0.8, np.float32)
    assert check.confidence(6, sure) is None
    for place in (0, 1, 4, 8, 11):
        kept = check.confidence(place, sure)
        assert kept is not None
        assert kept.max() <= 0.8
        assert np.median(kept) > 0.2


def test_a_keyframe_without_company_keeps_its_confidence() -> None:
    check = DepthFilter(Keyframes(views(2)), ConsistencySettings(), 0.1)  # type: ignore[arg-type]
    sure = np.full((SIZE, SIZE), 0.8, np.float32)
    np.testing.assert_array_equal(check.confidence(0, sure), sure)


@pytest.mark.parametrize("count", [3, 4])
def test_one_wild_keyframe_throws_no_good_one_out(count: int) -> None:
    frames = views(count)
    frames[-1] = DepthView(0.6 * frames[-1].depth, INTRINSICS, frames[-1].world_from_camera)
    check = DepthFilter(Keyframes(frames), ConsistencySettings(), 0.1)  # type: ignore[arg-type]
    sure = np.full((SIZE, SIZE), 0.8, np.float32)
    assert all(check.confidence(place, sure) is not None for place in range(count - 1))


def test_depth_that_is_not_believed_anyway_throws_no_keyframe_out() -> None:
    frames = views(12)
    doubted = np.full((SIZE, SIZE), 0.8, np.float32)
    doubted[:60] = 0
    wrong = frames[6].depth.copy()
    wrong[:60] *= 2
    frames[6] = DepthView(wrong, INTRINSICS, frames[6].world_from_camera)
    completed = Keyframes(frames)
    completed.confidences[6] = doubted
    check = DepthFilter(completed, ConsistencySettings(), 0.1)  # type: ignore[arg-type]
    kept = check.confidence(6, doubted)
    assert kept is not None
    assert np.median(kept[64:]) == pytest.approx(0.8, abs=0.01)


def test_what_is_voted_down_below_the_least_confidence_is_not_fused_at_all() -> None:
    frames = views(12)
    patched = frames[5].depth.copy()
    patched[30:50, 30:50] *= 1.3
    frames[5] = DepthView(patched, INTRINSICS, frames[5].world_from_camera)
    check = DepthFilter(Keyframes(frames), ConsistencySettings(), 0.1)  # type: ignore[arg-type]
    kept = check.confidence(5, np.full((SIZE, SIZE), 0.8, np.float32))
    assert kept is not None
    inner = kept[35:45, 35:45]  # at the patch's rim the others' own edge windows abstain
    assert (inner == 0).mean() > 0.9


def test_what_one_frame_alone_speaks_against_is_fused_though_the_frame_is_but_half_sure() -> None:
    """One vote against and none for leave a seventh, which is enough; a pixel that is itself too unsure is not."""
    frames = views(3)
    frames[2] = DepthView(0.6 * frames[2].depth, INTRINSICS, frames[2].world_from_camera)
    check = DepthFilter(Keyframes(frames), ConsistencySettings(steps=(2,)), 0.1)  # type: ignore[arg-type]
    votes, unsure = check(0), np.full((SIZE, SIZE), 0.5, np.float32)
    unsure[:48] = 0.09
    against = (votes.contradictions == 1) & (votes.supports == 0)
    kept = check.confidence(0, unsure)
    assert kept is not None
    assert against[48:].mean() > 0.2
    np.testing.assert_allclose(kept[48:][against[48:]], 0.5 / 7, rtol=1e-5)
    assert not kept[:48].any()


def test_depth_is_fused_where_its_error_in_the_surfaces_unit_is_small_enough() -> None:
    """Far wall of which a frame is sure stays, near wall of which it is not goes."""
    check = DepthFilter(Keyframes(views(1)), ConsistencySettings(), 0.1, max_error=0.5)  # type: ignore[arg-type]
    depth = views(1)[0].depth
    confidence = np.full((SIZE, SIZE), 0.9, np.float32)
    confidence[::2] = 0.3
    kept = check.confidence(0, confidence)
    assert kept is not None
    error = 0.03 * np.sqrt(1 / confidence - 1) * depth
    np.testing.assert_array_equal(kept > 0, (error <= 0.5) & (depth > 0))
    assert 0.1 < (kept > 0).mean() < 0.95
