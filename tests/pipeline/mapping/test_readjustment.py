"""Parts of a map, adjusted alone: a right one keeps its path, a bent one and one of a moving wall do not."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from pipeline.mapping.readjustment import by_halves_of_the_wall, by_stretches, path_difference
from pipeline.mapping.submap import Submap

CAMERA = Camera("PINHOLE", 320, 320, (160.0, 160.0, 160.0, 160.0))
FRAMES, POINTS = 40, 400


def poses_along(count=FRAMES):
    """Forward through a tube, swaying and turning."""
    t = np.linspace(0, 1, count)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, 3] = np.stack([0.15 * np.sin(7 * t), 0.1 * np.cos(5 * t), 1.5 * t], axis=1)
    poses[:, :3, :3] = Rotation.from_euler("xyz", np.stack([0.1 * np.sin(5 * t), 0.1 * t, 0.2 * t], axis=1)).as_matrix()
    return poses


def tube_map(move=None):
    """A map with true poses and a wall at rest; `move(world (K,3), t)` is where its points were as frame t saw them."""
    rng = np.random.default_rng(0)
    angle = rng.uniform(0, 2 * np.pi, POINTS)
    points = np.stack([0.6 * np.cos(angle), 0.4 * np.sin(angle), rng.uniform(0.5, 3, POINTS)], axis=1)
    poses, observations, pixels = poses_along(), [], []
    for row, world_from_camera in enumerate(poses):
        seen = points if move is None else move(points, row / (FRAMES - 1))
        local = (seen - world_from_camera[:3, 3]) @ world_from_camera[:3, :3]
        found = CAMERA.project(np.where(local[:, 2:] > 0.2, local, [0.0, 0.0, 1.0]))
        inside = (local[:, 2] > 0.2) & (local[:, 2] < 1.5) & (found > 0).all(axis=1) & (found < 320).all(axis=1)
        observations += [(row, point) for point in np.flatnonzero(inside)]
        pixels.append(found[inside])
    return Submap(
        np.arange(FRAMES),
        poses,
        points,
        np.zeros(POINTS),
        np.array(observations),
        np.concatenate(pixels) + rng.normal(0, 0.1, (len(observations), 2)),
        CAMERA.params,
    )


def test_a_similarity_is_no_difference_and_a_turn_of_the_cameras_is_one():
    poses = poses_along()
    moved = poses.copy()
    turn = Rotation.from_euler("z", 50, degrees=True).as_matrix()
    moved[:, :3, :3] = turn @ poses[:, :3, :3]
    moved[:, :3, 3] = 3 * poses[:, :3, 3] @ turn.T + 1
    same = path_difference(moved, poses)
    assert same.share < 1e-9
    assert same.angle_deg < 1e-5
    shaken = poses.copy()
    shaken[:, :3, 3] += np.random.default_rng(1).normal(0, 0.02, (FRAMES, 3))
    length = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    assert path_difference(shaken, poses).share == pytest.approx(0.02 * np.sqrt(3) / length, rel=0.2)


def test_a_straight_path_whose_cameras_look_elsewhere_is_told():
    """By the centres alone it is right."""
    poses = np.tile(np.eye(4), (FRAMES, 1, 1))
    poses[:, 2, 3] = np.linspace(0, 1, FRAMES)
    aside = poses.copy()
    aside[:, :3, :3] = Rotation.from_euler("y", 40, degrees=True).as_matrix()
    found = path_difference(aside, poses)
    assert found.share > 0.05 or found.angle_deg > 5


def test_a_right_map_keeps_its_path_and_a_bent_one_does_not():
    right = tube_map()
    assert by_stretches(right, CAMERA).share < 0.002
    bent = right.world_from_camera.copy()
    bent[:, 0, 3] += 0.1 * np.linspace(-1, 1, FRAMES) ** 2
    assert by_stretches(replace(right, world_from_camera=bent), CAMERA).share > 0.01


def test_halves_of_a_wall_that_moves_apart_give_two_paths():
    def apart(points, t):
        return points + np.sign(points[:, :1]) * [0.05 * np.sin(9 * t), 0, 0]

    still, moving = (by_halves_of_the_wall(tube_map(move), CAMERA) for move in (None, apart))
    assert still.share < 0.005
    assert moving.share > 3 * still.share


def test_what_is_too_short_has_no_parts():
    few = tube_map().without_frames(set(range(5, FRAMES)))
    assert by_stretches(few, CAMERA) is None
    assert by_halves_of_the_wall(few, CAMERA) is None
