"""Motions as tangents and shares of motions, beside SciPy's rotations."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from haustra.core.se3 import interpolated, motion_of, share_of, tangent_of


def motion(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.random(random_state=rng).as_matrix(), rng.normal(size=3)
    return made


@given(st.integers(0, 1000))
def test_a_motion_comes_back_from_its_tangent(seed: int) -> None:
    np.testing.assert_allclose(motion_of(tangent_of(motion(seed))), motion(seed), atol=1e-12)


@given(st.integers(0, 1000), st.floats(0, 1))
def test_a_share_turns_as_slerp_does_and_shifts_in_proportion(seed: int, share: float) -> None:
    whole = motion(seed)
    part = share_of(whole, share)
    turns = Slerp([0, 1], Rotation.from_matrix([np.eye(3), whole[:3, :3]]))
    np.testing.assert_allclose(part[:3, :3], turns(share).as_matrix(), atol=1e-9)
    np.testing.assert_allclose(part[:3, 3], share * whole[:3, 3], atol=1e-12)


@given(st.integers(0, 2**32 - 1))
def test_between_poses_rotations_go_as_slerp_and_centres_straight(seed: int) -> None:
    rng = np.random.default_rng(seed)
    seconds, wanted = np.cumsum(rng.uniform(0.1, 1, 6)), rng.uniform(-1, 7, 9)
    turns = Rotation.from_rotvec(rng.uniform(-1, 1, (6, 3)))
    poses = np.tile(np.eye(4), (6, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = turns.as_matrix(), rng.normal(size=(6, 3))
    found, inside = interpolated(seconds, poses, wanted), np.clip(wanted, seconds[0], seconds[-1])
    np.testing.assert_allclose(found[:, :3, :3], Slerp(seconds, turns)(inside).as_matrix(), atol=1e-9)
    for axis in range(3):
        np.testing.assert_allclose(found[:, axis, 3], np.interp(inside, seconds, poses[:, axis, 3]), atol=1e-12)
    np.testing.assert_array_equal(found[:, 3], np.tile([0, 0, 0, 1], (9, 1)))
