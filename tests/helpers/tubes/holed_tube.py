"""Tubes with holes of known area and place, and cameras that pass through them."""

import numpy as np

from reconstruction.mesh.surface_mesh import SurfaceMesh

RADIUS, LENGTH, EDGE = 20.0, 120.0, 1.2
BEND = 60.0  # radius of the torus's middle line


def straight(s):
    """Middle line along z: points, tangents and the axis at angle 0 (N,3 each)."""
    zero = np.zeros_like(s)
    return np.stack([zero, zero, s], -1), np.stack([zero, zero, zero + 1], -1), np.stack([zero, zero - 1, zero], -1)


def bent(s):
    """A quarter of a circle in the x-z plane."""
    a = s / BEND
    points = np.stack([BEND * (1 - np.cos(a)), 0 * a, BEND * np.sin(a)], -1)
    return points, np.stack([np.sin(a), 0 * a, np.cos(a)], -1), np.stack([0 * a, 0 * a - 1, 0 * a], -1)


def tube(middle, hole=None, length=LENGTH, radius=lambda s, angle: RADIUS + 0 * s):
    """A tube as a grid mesh seen from inside; faces whose centre has `hole(s, angle)` are left out.

    The angle is 0 at -y and grows towards +x: clockwise for one who looks along the line with y down.
    """
    rows, columns = int(length / EDGE) + 1, int(2 * np.pi * RADIUS / EDGE)
    s, angle = np.meshgrid(np.linspace(0, length, rows), np.arange(columns) * 2 * np.pi / columns, indexing="ij")
    points, tangent, up = middle(s)
    right = np.cross(tangent, up)
    outward = np.cos(angle)[..., None] * up + np.sin(angle)[..., None] * right
    vertices = (points + radius(s, angle)[..., None] * outward).reshape(-1, 3)
    here = np.arange((rows - 1) * columns).reshape(rows - 1, columns)
    across, ahead = np.roll(here, -1, axis=1), here + columns
    corner = across + columns
    faces = np.stack([np.stack([here, ahead, across], -1), np.stack([across, ahead, corner], -1)], 2).reshape(-1, 3)
    mesh = SurfaceMesh.from_triangles(vertices, faces)
    if hole is None:
        return mesh
    middle_s = np.repeat((s[:-1] + s[1:]).ravel() / 2, 2)
    middle_angle = np.repeat((angle[:-1] + np.pi / columns).ravel(), 2)
    return mesh.with_faces(~hole(middle_s, middle_angle))


def cameras(middle, start=10.0, end=90.0, count=30, off=2.0):
    """Cameras that look along the line, y down, somewhat off it."""
    s = np.linspace(start, end, count)
    points, tangent, up = middle(s)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = np.stack([np.cross(tangent, up), -up, tangent], axis=-1)
    poses[:, :3, 3] = points + off * np.sin(s / 7)[:, None] * up
    return poses


def patch(s0, s1, from_deg, to_deg):
    low, high = np.radians([from_deg, to_deg])
    return lambda s, angle: (s > s0) & (s < s1) & (angle > low) & (angle < high)


HOLE = patch(55, 70, 60, 120)
