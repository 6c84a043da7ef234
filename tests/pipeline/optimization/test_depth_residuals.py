"""Depth residuals of bundle adjustment, against autodiff, and what they do to a scene's free scale."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.optimization.bundle_adjustment import Bundle, adjust
from pipeline.optimization.depth_residuals import SIGMA_PX, MeasuredDepth, add_depth_equations, depth_cost

LOSS = 0.8


def scene(seed: int = 0) -> tuple[Bundle, np.ndarray]:
    """Cameras that look along z at a slab of points, seen with 0.3 px of noise; and the depth (M,) of each sight."""
    rng = np.random.default_rng(seed)
    count, places = 6, 80
    rotation = Rotation.from_rotvec(rng.normal(0, 0.05, (count, 3))).as_matrix()
    translation = np.column_stack([np.linspace(0, 8, count), rng.normal(0, 0.5, (count, 2))])
    points = rng.uniform([-12, -12, 20], [12, 12, 50], (places, 3))
    camera, point = np.repeat(np.arange(count), places), np.tile(np.arange(places), count)
    local = np.einsum("mij,mj->mi", rotation[camera], points[point]) + translation[camera]
    xy = local[:, :2] / local[:, 2:] + rng.normal(0, 0.3 / 160, (len(camera), 2))
    jacobian = np.tile(160 * np.eye(2), (len(camera), 1, 1))
    fixed = np.arange(count) == 0
    return Bundle(rotation, translation, points, camera, point, xy, jacobian, fixed), local[:, 2]


def measured(depth: np.ndarray, error: float, rng: np.random.Generator) -> MeasuredDepth:
    rows = np.flatnonzero(rng.random(len(depth)) < 0.5)
    noisy = depth[rows] * (1 + error * rng.normal(size=len(rows)))
    return MeasuredDepth(rows, noisy, np.full(len(rows), error))


def blocks_of(bundle: Bundle) -> tuple[np.ndarray, ...]:
    cameras, points = len(bundle.rotation), len(bundle.points)
    return (
        np.zeros((cameras, 6, 6)), np.zeros((points, 3, 3)), np.zeros((len(bundle.camera), 6, 3)),
        np.zeros((cameras, 6)), np.zeros((points, 3)),
    )  # fmt: skip


def residuals(tangent: torch.Tensor, shift: torch.Tensor, bundle: Bundle, given: MeasuredDepth) -> torch.Tensor:
    zero = torch.zeros(len(tangent), dtype=torch.float64)
    x, y, z = tangent[:, :3].T
    turn = torch.matrix_exp(torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3))
    rotation = turn @ torch.from_numpy(bundle.rotation)
    translation = (turn @ torch.from_numpy(bundle.translation)[:, :, None])[:, :, 0] + tangent[:, 3:]
    camera, point = bundle.camera[given.observation], bundle.point[given.observation]
    world = (torch.from_numpy(bundle.points) + shift)[point]
    depth = (rotation[camera] @ world[:, :, None])[:, 2, 0] + translation[camera][:, 2]
    return SIGMA_PX * (torch.from_numpy(given.depth) / depth - 1) / torch.from_numpy(given.error)


def test_their_equations_and_their_cost_are_those_of_autodiff():
    bundle, depth = scene()
    given = measured(1.1 * depth, 0.03, np.random.default_rng(1))
    blocks = blocks_of(bundle)
    arrays = (*bundle.arrays[:5], given.observation, given.depth, given.error)
    add_depth_equations(*arrays, np.zeros(6, bool), LOSS, *blocks)
    at = torch.zeros(6, 6, dtype=torch.float64), torch.zeros(80, 3, dtype=torch.float64)
    off = residuals(*at, bundle, given).numpy()
    by_pose, by_point = torch.autograd.functional.jacobian(lambda a, b: residuals(a, b, bundle, given), at)
    jacobian = np.concatenate([by_pose.reshape(len(off), -1).numpy(), by_point.reshape(len(off), -1).numpy()], axis=1)
    weight = 1 / (1 + off**2 / LOSS**2)
    full, side = jacobian.T @ (weight[:, None] * jacobian), -jacobian.T @ (weight * off)
    np.testing.assert_allclose(blocks[3].ravel(), side[:36], rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(blocks[4].ravel(), side[36:], rtol=1e-9, atol=1e-9)
    for c in range(6):
        np.testing.assert_allclose(blocks[0][c], full[6 * c : 6 * c + 6, 6 * c : 6 * c + 6], rtol=1e-9, atol=1e-7)
    for p in (0, 41, 79):
        at_point = slice(36 + 3 * p, 39 + 3 * p)
        np.testing.assert_allclose(blocks[1][p], full[at_point, at_point], rtol=1e-9, atol=1e-7)
    for m in (3, 100, 479):
        rows = slice(6 * bundle.camera[m], 6 * bundle.camera[m] + 6)
        columns = slice(36 + 3 * bundle.point[m], 39 + 3 * bundle.point[m])
        np.testing.assert_allclose(blocks[2][m], full[rows, columns], rtol=1e-9, atol=1e-7)
    assert depth_cost(*arrays, LOSS) == pytest.approx(LOSS**2 * np.log1p(off**2 / LOSS**2).sum(), rel=1e-12)


def test_a_fixed_camera_stays_and_its_points_move():
    bundle, depth = scene()
    given = MeasuredDepth(np.array([5]), depth[[5]] * 1.2, np.array([0.02]))
    blocks = blocks_of(bundle)
    arrays = (*bundle.arrays[:5], given.observation, given.depth, given.error)
    add_depth_equations(*arrays, bundle.fixed, LOSS, *blocks)
    assert not blocks[0].any()
    assert not blocks[2].any()
    assert np.flatnonzero(blocks[4].any(axis=1)).tolist() == [bundle.point[5]]


def test_they_set_the_scale_that_pictures_leave_free():
    bundle, depth = scene(3)
    grown = replace(bundle, translation=1.15 * bundle.translation, points=1.15 * bundle.points)
    rng = np.random.default_rng(4)
    noisy = measured(depth, 0.03, rng)
    wild = noisy.observation % 10 == 0  # a twentieth is three times as far
    given = replace(noisy, depth=np.where(wild, 3 * noisy.depth, noisy.depth))
    found = adjust(replace(grown, measured=given), 40, LOSS, 1e-9)
    centres = -np.einsum("cji,cj->ci", found.rotation, found.translation)
    true = -np.einsum("cji,cj->ci", bundle.rotation, bundle.translation)
    length, expected = (float(np.linalg.norm(c[-1] - c[0])) for c in (centres, true))
    assert length == pytest.approx(expected, rel=0.01)
    alone = adjust(grown, 40, LOSS, 1e-9)
    centres = -np.einsum("cji,cj->ci", alone.rotation, alone.translation)
    assert float(np.linalg.norm(centres[-1] - centres[0])) == pytest.approx(1.15 * expected, rel=0.05)


def test_without_any_nothing_changes():
    bundle, _ = scene(5)
    nothing = MeasuredDepth(np.zeros(0, np.int64), np.zeros(0), np.zeros(0))
    one, other = (adjust(b, 10, LOSS) for b in (bundle, replace(bundle, measured=nothing)))
    np.testing.assert_array_equal(one.points, other.points)
    np.testing.assert_array_equal(one.translation, other.translation)
