"""A tube with bumps, its depth as a sensor sees it, and its submap."""

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from haustra.core.camera import Camera
from pipeline.mapping.submap import Submap

SOURCE, BOX, SCALE = (240, 200), (20, 10, 200, 180), 0.5  # the content is cut out and halved
CAMERA = Camera("OPENCV", 100, 90, (50.0, 50.0, 52.0, 44.0, -0.05, 0.0, 0.0, 0.0))
FULL = CAMERA.cropped_and_scaled(-10, -5, 120, 100, 2.0)  # of the source picture
RADIUS_MM, MM_PER_UNIT, COUNT, STEP_MM = 22.0, 31.0, 20, 2.0
BUMPS = 4 * gaussian_filter(np.random.default_rng(3).normal(size=(90, 120)), 4.0, mode="wrap")
BUMPS *= 2.0 / BUMPS.std()


def world_from_camera(k):
    """Along the tube, beside its axis."""
    found = np.eye(4)
    found[:3, 3] = 3 * np.sin(0.4 * k), 2 * np.cos(0.3 * k), STEP_MM * k
    return found


def wall_depth(rays, k):
    """z-depth (N,) in mm where rays (N,3) of z = 1 meet the tube, whose radius has bumps."""
    centre, radius = world_from_camera(k)[:3, 3], np.full(len(rays), RADIUS_MM)
    for _ in range(6):
        a = (rays[:, :2] ** 2).sum(axis=1)
        b = (rays[:, :2] * centre[:2]).sum(axis=1)
        depth = (-b + np.sqrt(b * b - a * ((centre[:2] ** 2).sum() - radius**2))) / np.maximum(a, 1e-9)
        hit = centre + depth[:, None] * rays
        turn = (np.arctan2(hit[:, 1], hit[:, 0]) / (2 * np.pi) * 90).astype(int) % 90
        radius = RADIUS_MM + BUMPS[turn, (hit[:, 2] / 2).astype(int) % 120]
    return depth


def through(camera, pixels):
    plane, _ = camera.unproject(pixels)
    return np.column_stack([plane, np.ones(len(plane))])


def submap():
    """Points of a grid of pixels of every third frame, seen by the frames around; in scene units, with 1 % of error."""
    rng, points, observations, pixels = np.random.default_rng(0), [], [], []
    x, y = np.meshgrid(np.arange(6, 100, 6.0), np.arange(6, 90, 6.0))
    for k in range(0, COUNT, 3):
        grid = np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-2, 2, (x.size, 2))
        rays = through(CAMERA, grid)
        depth = wall_depth(rays, k)
        near = depth < 90
        for place in (
            world_from_camera(k)[:3, 3] + rays[near] * (depth[near] * (1 + 0.01 * rng.normal(size=near.sum())))[:, None]
        ):
            for j in range(max(0, k - 3), min(COUNT, k + 4)):
                local = place - world_from_camera(j)[:3, 3]
                seen = CAMERA.project(local[None])[0] if local[2] > 5 else np.array([-1.0, -1.0])
                if (seen > 0).all() and (seen < [100, 90]).all():
                    observations.append((j, len(points)))
                    pixels.append(seen)
            points.append(place / MM_PER_UNIT)
    poses = np.stack([world_from_camera(k) for k in range(COUNT)])
    poses[:, :3, 3] /= MM_PER_UNIT
    return Submap(
        np.arange(COUNT), poses, np.array(points), np.full(len(points), 0.3), np.array(observations), np.array(pixels),
        CAMERA.params,
    )  # fmt: skip


def write_sensor(folder, unit_mm=0.05, noise=0.02, zones=(48, 40), along_ray=False):
    """Depth images of all frames; along_ray: of distances along each cell's ray."""
    folder.mkdir(parents=True)
    rng = np.random.default_rng(1)
    x, y = np.meshgrid(
        (np.arange(zones[0]) + 0.5) * SOURCE[0] / zones[0], (np.arange(zones[1]) + 0.5) * SOURCE[1] / zones[1]
    )
    rays = through(FULL, np.column_stack([x.ravel(), y.ravel()]))
    for k in range(COUNT):
        depth = wall_depth(rays, k) * (1 + noise * rng.normal(size=len(rays)))
        depth[(rng.random(len(rays)) < 0.2) | (depth > 150)] = 0
        depth = depth * np.linalg.norm(rays, axis=1) if along_ray else depth
        raw = np.clip(np.rint(depth / unit_mm), 0, 65535).astype(np.uint16).reshape(zones[1], zones[0])
        cv2.imwrite(str(folder / f"{k:05d}.png"), raw)
