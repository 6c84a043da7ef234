"""Dense registration, which the benchmark keeps and the pipeline does not use: a tube must leave axis and roll free."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.registration import register
from reconstruction.fusion.depth_consistency import DepthView

SIDE = 96
INTRINSICS = np.array([[50.0, 0, 48], [0, 50.0, 48], [0, 0, 1]])


def tube_depth(world_from_camera: np.ndarray, folds: float = 0.0) -> np.ndarray:
    """(H,W) z-depth of a tube of radius 1 along z, by marching; `folds`: lobes all round that also change along it."""
    rows, columns = np.indices((SIDE, SIDE)) + 0.5
    rays = np.stack([columns, rows, np.ones((SIDE, SIDE))], axis=-1) @ np.linalg.inv(INTRINSICS).T
    rays = rays @ world_from_camera[:3, :3].T
    near, far = np.zeros((SIDE, SIDE)), np.full((SIDE, SIDE), 6.0)

    def outside(depth: np.ndarray) -> np.ndarray:
        x, y, z = np.moveaxis(world_from_camera[:3, 3] + depth[..., None] * rays, -1, 0)
        return np.hypot(x, y) > 1 - folds * (1 + np.sin(2.5 * z) * np.cos(3 * np.arctan2(y, x)))

    for _ in range(40):
        middle = (near + far) / 2
        hit = outside(middle)
        near, far = np.where(hit, near, middle), np.where(hit, middle, far)
    return np.where(near < 5.9, near, 0).astype(np.float32)


def view(pose: np.ndarray, folds: float = 0.0) -> DepthView:
    return DepthView(tube_depth(pose, folds), INTRINSICS, np.eye(4))


def pose(tangent: tuple[float, ...]) -> np.ndarray:
    result = np.eye(4)
    result[:3, :3] = Rotation.from_rotvec(tangent[:3]).as_matrix()
    result[:3, 3] = tangent[3:]
    return result


def test_a_smooth_tube_leaves_axis_and_roll_where_the_guess_put_them():
    true = pose((0.0, 0.04, 0.0, 0.05, 0.0, 0.1))
    guess = true @ pose((0.02, -0.02, 0.05, 0.02, 0.03, 0.08))
    found = register(view(true), view(np.eye(4)), guess)
    assert found is not None
    information = np.diag(found.information[:6, :6])
    axis = true[:3, :3].T @ [0, 0, 1]  # of the tube, in the source's axes
    along = axis @ found.information[3:6, 3:6] @ axis
    assert along < 1e-2 * information[3:5].min()
    values = np.linalg.eigvalsh(found.information[:6, :6])
    assert values[1] < 1e-2 * values[2]  # two directions next to nothing, four held
    off = np.linalg.inv(true) @ found.target_from_source
    assert np.linalg.norm(off[:2, 3]) < 0.01  # across: found
    assert off[2, 3] == pytest.approx(0.08, abs=0.02)  # along: the guess's
    assert Rotation.from_matrix(off[:3, :3]).as_rotvec()[2] == pytest.approx(0.05, abs=0.01)


def test_folds_hold_every_direction():
    true = pose((0.0, 0.04, 0.0, 0.05, 0.0, 0.1))
    guess = true @ pose((0.01, -0.01, 0.02, 0.02, 0.02, 0.03))
    found = register(view(true, 0.08), view(np.eye(4), 0.08), guess)
    assert found is not None
    off = np.linalg.inv(true) @ found.target_from_source
    assert np.linalg.norm(off[:3, 3]) < 0.004
    assert Rotation.from_matrix(off[:3, :3]).magnitude() < 0.004
    values = np.linalg.eigvalsh(found.information[:6, :6])
    assert values[0] > 1e-4 * values[-1]


def test_scale_is_found_where_it_is_free_and_has_no_information_where_it_is_not():
    true = pose((0.0, 0.04, 0.0, 0.05, 0.0, 0.1))
    large = view(true, 0.08)
    large = DepthView(large.depth * np.float32(1.05), INTRINSICS, np.eye(4))
    found = register(large, view(np.eye(4), 0.08), true, with_scale=True)
    assert found is not None
    assert np.cbrt(np.linalg.det(found.target_from_source[:3, :3])) == pytest.approx(1 / 1.05, abs=0.005)
    rigid = register(view(true, 0.08), view(np.eye(4), 0.08), true)
    assert rigid is not None
    assert not rigid.information[6].any()


def test_too_little_overlap_is_no_registration():
    away = pose((0, np.pi, 0, 0, 0, 0))
    assert register(view(np.eye(4)), view(np.eye(4)), away) is None
