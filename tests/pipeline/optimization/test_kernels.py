"""The compiled loops of bundle adjustment, against autodiff and full matrices."""

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from pipeline.optimization.kernels import normal_equations, pose_equations, robust_cost

CAMERAS, POINTS, LOSS = 4, 9, 1.5


def problem(seed: int = 0) -> tuple[np.ndarray, ...]:
    """A little of everything: lenses with a shear, an outlier, a point that nobody sees, a camera that sees nothing."""
    rng = np.random.default_rng(seed)
    rotation = Rotation.from_rotvec(rng.normal(0, 0.2, (CAMERAS, 3))).as_matrix()
    translation = rng.normal(0, 0.3, (CAMERAS, 3))
    points = rng.normal(0, 1, (POINTS, 3)) + np.array([0, 0, 6])
    sees = rng.random((CAMERAS, POINTS)) < 0.7
    sees[:, 5] = sees[2] = False
    camera, point = (np.ascontiguousarray(k) for k in np.nonzero(sees))  # as `adjust` gives them
    local = np.einsum("mij,mj->mi", rotation[camera], points[point]) + translation[camera]
    seen = local[:, :2] / local[:, 2:] + rng.normal(0, 0.005, (len(camera), 2))
    seen[3] += 0.2
    gain = 200 * np.eye(2) + rng.normal(0, 20, (len(camera), 2, 2))
    return rotation, translation, points, camera, point, seen, gain


def residuals(tangent: torch.Tensor, shift: torch.Tensor, given: tuple[np.ndarray, ...]) -> torch.Tensor:
    """(M,2) pixels after the poses' left update and a shift of the points."""
    rotation, translation, points, camera, point, seen, gain = (torch.from_numpy(a) for a in given)
    zero = torch.zeros(CAMERAS, dtype=torch.float64)
    x, y, z = tangent[:, :3].T
    skew = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero], dim=1).reshape(-1, 3, 3)
    turn = torch.matrix_exp(skew)
    rotation = turn @ rotation
    translation = (turn @ translation[:, :, None])[:, :, 0] + tangent[:, 3:]
    local = (rotation[camera] @ (points + shift)[point][:, :, None])[:, :, 0] + translation[camera]
    off = local[:, :2] / local[:, 2:] - seen
    return (gain @ off[:, :, None])[:, :, 0]


def by_autodiff(given: tuple[np.ndarray, ...]) -> tuple[np.ndarray, np.ndarray]:
    """The full weighted normal matrix over all cameras, then all points, and its right-hand side."""
    at = (torch.zeros(CAMERAS, 6, dtype=torch.float64), torch.zeros(POINTS, 3, dtype=torch.float64))
    value = residuals(*at, given).numpy()
    by_pose, by_point = torch.autograd.functional.jacobian(lambda a, b: residuals(a, b, given), at)
    rows = 2 * len(value)
    jacobian = np.concatenate([by_pose.reshape(rows, -1).numpy(), by_point.reshape(rows, -1).numpy()], axis=1)
    weight = np.repeat(1 / (1 + (value**2).sum(axis=1) / LOSS**2), 2)
    return jacobian.T @ (weight[:, None] * jacobian), -jacobian.T @ (weight * value.ravel())


@pytest.mark.parametrize("fixed", [[], [0], [0, 3]])
def test_the_normal_equations_are_those_of_autodiff(fixed):
    given = problem()
    camera, point = given[3:5]
    held = np.isin(np.arange(CAMERAS), fixed)
    of_cameras, of_points, cross, camera_side, point_side = normal_equations(*given, held, LOSS)
    full = np.zeros((6 * CAMERAS + 3 * POINTS,) * 2)
    split = 6 * CAMERAS
    for c in range(CAMERAS):
        full[6 * c : 6 * c + 6, 6 * c : 6 * c + 6] = of_cameras[c]
    for p in range(POINTS):
        full[split + 3 * p : split + 3 * p + 3, split + 3 * p : split + 3 * p + 3] = of_points[p]
    for m, (c, p) in enumerate(zip(camera, point, strict=True)):
        full[6 * c : 6 * c + 6, split + 3 * p : split + 3 * p + 3] = cross[m]
        full[split + 3 * p : split + 3 * p + 3, 6 * c : 6 * c + 6] = cross[m].T
    matrix, side = by_autodiff(given)
    moves = np.concatenate([np.repeat(~held, 6), np.ones(3 * POINTS, bool)])
    matrix, side = matrix * np.outer(moves, moves), side * moves
    np.testing.assert_allclose(full, matrix, rtol=1e-9, atol=1e-7)
    np.testing.assert_allclose(np.concatenate([camera_side.ravel(), point_side.ravel()]), side, rtol=1e-9, atol=1e-7)


def test_the_equations_of_poses_alone_are_the_same():
    given = problem(1)
    of_cameras, _, _, camera_side, _ = normal_equations(*given, np.zeros(CAMERAS, bool), LOSS)
    rotation, translation, points, camera, point, seen, gain = given
    blocks, side = pose_equations(rotation, translation, points[point], camera, seen, gain, LOSS)
    np.testing.assert_allclose(blocks, of_cameras, rtol=1e-12)
    np.testing.assert_allclose(side, camera_side, rtol=1e-12)
    assert not blocks[2].any()  # the camera that sees nothing


def test_the_cost_is_cauchys():
    given = problem(2)
    off = residuals(torch.zeros(CAMERAS, 6).double(), torch.zeros(POINTS, 3).double(), given).numpy()
    expected = LOSS**2 * np.log1p((off**2).sum(axis=1) / LOSS**2).sum()
    assert robust_cost(*given, LOSS) == pytest.approx(expected, rel=1e-12)


def test_a_point_behind_a_camera_costs_much_and_breaks_nothing():
    rotation, translation, points, camera, point, seen, gain = problem(3)
    before = robust_cost(rotation, translation, points, camera, point, seen, gain, LOSS)
    points[0] = [0.3, 0.2, -5]
    given = (rotation, translation, points, camera, point, seen, gain)
    assert robust_cost(*given, LOSS) > before + 50
    assert all(np.isfinite(a).all() for a in normal_equations(*given, np.zeros(CAMERAS, bool), LOSS))
