"""Rendered views of a textured tube with a lamp at the camera, and odometry run on them."""

import numpy as np
from scipy.ndimage import gaussian_filter, map_coordinates
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.input.frames import Frames, write_image
from pipeline.mapping.local_map import LocalMap
from pipeline.mapping.map_adjustment import adjust_all
from pipeline.run_folder.workspace import Workspace

SIZE = 192
CAMERA = Camera("PINHOLE", SIZE, SIZE, (96.0, 96.0, 96.0, 96.0))
RADIUS = 20.0
MASK = np.full((SIZE, SIZE), 255, dtype=np.uint8)


def wall_texture(seed=0):
    """(angle, height) -> reflectance: blotches from a pixel's size to a fold's."""
    rng = np.random.default_rng(seed)
    layers = [gaussian_filter(rng.normal(size=(720, 1200)), s, mode="wrap") for s in (2.0, 4.0, 9.0)]
    summed = sum(layer / layer.std() for layer in layers)
    return 0.5 + 0.12 * summed


TEXTURE = wall_texture()


def camera_at(k, step=0.8):
    """world_from_camera of frame k: along the axis, off it, with a little sway."""
    world_from_camera = np.eye(4)
    turn = [2 * np.sin(0.11 * k), 3 * np.sin(0.07 * k + 1), 4 * np.sin(0.05 * k)]
    world_from_camera[:3, :3] = Rotation.from_euler("xyz", turn, degrees=True).as_matrix()
    world_from_camera[:3, 3] = [3 * np.sin(0.09 * k), 2.5 * np.cos(0.06 * k), step * k]
    return world_from_camera


def render(world_from_camera, camera=CAMERA):
    """The tube under a lamp at the camera: exact intersection of each pixel's ray with the cylinder."""
    columns, rows = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    plane, _ = camera.unproject(np.column_stack([columns.ravel(), rows.ravel()]))
    rays = np.column_stack([plane, np.ones(len(plane))]).reshape(SIZE, SIZE, 3) @ world_from_camera[:3, :3].T
    centre = world_from_camera[:3, 3]
    a = (rays[..., :2] ** 2).sum(-1)
    b = (rays[..., :2] * centre[:2]).sum(-1)
    length = (-b + np.sqrt(b * b - a * ((centre[:2] ** 2).sum() - RADIUS**2))) / np.maximum(a, 1e-9)
    hit = centre + length[..., None] * rays
    place = [(np.arctan2(hit[..., 1], hit[..., 0]) / (2 * np.pi) % 1) * 720, hit[..., 2] * 6.0]
    reflectance = map_coordinates(TEXTURE, place, order=1, mode="grid-wrap")
    distance = np.linalg.norm(hit - centre, axis=-1)
    value = np.clip(255 * reflectance * np.minimum((22 / np.maximum(distance, 1)) ** 2, 1.6), 0, 245)
    return np.repeat(value[..., None], 3, axis=2).astype(np.uint8)


def true_depth(world_from_camera):
    """z-depth (H,W) of the tube through `CAMERA`: each pixel's ray with the cylinder; 0 beyond four radii."""
    x, y = np.meshgrid(np.arange(SIZE) + 0.5, np.arange(SIZE) + 0.5)
    rays = np.stack([x, y, np.ones_like(x)], axis=-1) @ np.linalg.inv(CAMERA.matrix).T @ world_from_camera[:3, :3].T
    centre = world_from_camera[:3, 3]
    a, b = (rays[..., :2] ** 2).sum(-1), (rays[..., :2] * centre[:2]).sum(-1)
    z = (-b + np.sqrt(b * b - a * ((centre[:2] ** 2).sum() - RADIUS**2))) / np.maximum(a, 1e-9)
    return np.where(z < 4 * RADIUS, z, 0).astype(np.float32)


def run(images, seed=0, mask=MASK):
    odometry = Odometry(RayTable(CAMERA), seed)
    states = [odometry.process(k, image, odometry.view(image, mask)) for k, image in enumerate(images)]
    return odometry.finish(), states


def polished(maps: list[LocalMap]) -> list[LocalMap]:
    for local_map in maps:
        adjust_all(local_map)
    return maps


def stored(tmp_path, images):
    workspace = Workspace(tmp_path)
    for folder in (workspace.images, workspace.masks, workspace.log):
        folder.mkdir()
    import cv2

    for k, image in enumerate(images):
        write_image(workspace.image_path(k), image)
        cv2.imwrite(str(workspace.mask_path(k)), MASK)
    index = np.arange(len(images))
    return workspace, Frames(index, index / 30.0, CAMERA, MASK, {"used": len(images)})
