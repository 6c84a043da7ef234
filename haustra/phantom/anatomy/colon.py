"""Mesh of a gut: the wall as a radius over (arc length, angle), wrapped around a centreline.

Rows of the grid run along the gut, columns around it. Rows are spaced by wall length, not by arc length, so
that steep flanks of folds get as many vertices (and texels) per millimetre as the flat wall.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.phantom.anatomy.bulb import Bulb
from haustra.phantom.anatomy.centreline import Centreline, grow_centreline
from haustra.phantom.anatomy.folds import place_folds
from haustra.phantom.anatomy.lesions import (
    POUCH_FLARE_MM,
    BulbPlacer,
    Diverticulum,
    Polyp,
    bump_footprint,
    place_flat,
    place_sessile,
)
from haustra.phantom.anatomy.wall import Wall, arc_at, unrolled_length
from haustra.phantom.config import AnatomyConfig

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
BULB_COLUMNS = 1.4  # factor on the columns of a gut with bulbs; rows are spaced by each bulb's own stretch
ROW_STEP_MM = 0.25  # sampling of the wall for row spacing; far below a mesh edge


@dataclass(frozen=True)
class Colon:
    """Mesh of a gut as a grid of quads: M rows along, N columns around, of which column N is column 0 again."""

    anatomy: AnatomyConfig
    line: Centreline
    arc: Array  # (M,) arc length of each row, mm
    points: Floats  # (M,N,3) mm
    normals: Floats  # (M,N,3) unit, into the lumen
    polyp_cover: Floats  # (M,N) 0 on plain wall, 1 on a polyp
    spacing_mm: tuple[float, float]  # typical edge along and around
    polyps: list[Polyp]
    diverticula: list[Diverticulum]

    @property
    def vertices(self) -> Floats:
        """(M*N,3) mm."""
        return self.points.reshape(-1, 3)

    @cached_property
    def triangles(self) -> NDArray[np.int32]:
        """(2*(M-1)*N,3), normals into the lumen; two per cell in row-major order, as `grid_position` expects."""
        rows, columns = self.points.shape[:2]
        here = np.arange((rows - 1) * columns, dtype=np.int32).reshape(rows - 1, columns)
        right = np.roll(here, -1, axis=1)
        below, corner = here + columns, right + columns
        lower = np.stack([here, below, right], axis=-1)
        upper = np.stack([corner, right, below], axis=-1)
        return np.stack([lower, upper], axis=2).reshape(-1, 3)

    def grid_position(self, triangle: NDArray[np.uint32], bary: Floats) -> tuple[Floats, Floats]:
        """Fractional row and column of surface points on the grid, continuous across column N."""
        cell, upper = np.divmod(triangle.astype(np.int32), 2)
        row, column = np.divmod(cell, self.points.shape[1])
        along = np.where(upper, 1 - bary[..., 0], bary[..., 0])
        around = np.where(upper, 1 - bary[..., 1], bary[..., 1])
        return (row + along).astype(np.float32), (column + around).astype(np.float32)


def build_colon(anatomy: AnatomyConfig, seed: int) -> Colon:
    """Mesh of the gut that config and seed determine."""
    rng = np.random.default_rng([seed, 1])
    line = grow_centreline(anatomy, rng)
    folds, sessile = place_folds(anatomy, rng), place_sessile(anatomy, rng)
    polyps = sessile + place_flat(anatomy, sessile, _own_generator(seed, 1))
    wall = Wall(anatomy, line, folds, polyps, rng, _own_generator(seed, 2))
    stalked, pouches = _grow_bulbs(wall, seed)
    bulbs = stalked + pouches
    arc, angle = _space_rows(wall, bulbs), _space_columns(anatomy, bulbs)
    points, cover, sheet = _draw(wall, bulbs, arc, angle)
    floats = points.astype(np.float32)
    return Colon(
        anatomy=anatomy,
        line=line,
        arc=arc,
        points=floats,
        normals=grid_normals(points),
        polyp_cover=cover.astype(np.float32),
        spacing_mm=(anatomy.edge_mm, 2 * np.pi * anatomy.radius_mm / len(angle)),
        polyps=[_with_apex(polyp, *sheet, points) for polyp in [*polyps, *map(_as_polyp, stalked)]],
        diverticula=[_as_diverticulum(pouch) for pouch in pouches],
    )


def _own_generator(seed: int, feature: int) -> np.random.Generator:
    """Random generator of one feature: one added later does not change the numbers that earlier ones draw."""
    return np.random.default_rng([seed, 1, feature])


def _grow_bulbs(wall: Wall, seed: int) -> tuple[list[Bulb], list[Bulb]]:
    """Placed bulbs: polyps on stalks, and diverticula."""
    anatomy = wall.anatomy
    if not anatomy.pedunculated + anatomy.diverticula:
        return [], []
    dense, _, _ = _draw(wall, [], _space_rows(wall, []), _space_columns(anatomy, []))
    taken = [bump_footprint(polyp, anatomy) for polyp in wall.polyps]
    placer = BulbPlacer(wall.points, anatomy, [cKDTree(dense.reshape(-1, 3))], taken)
    return placer.polyps(_own_generator(seed, 3)), placer.diverticula(_own_generator(seed, 4))


def _space_columns(anatomy: AnatomyConfig, bulbs: list[Bulb]) -> Array:
    """Even angles (N,) rad of the columns."""
    edge_mm = anatomy.edge_mm / (BULB_COLUMNS if bulbs else 1)
    columns = max(24, round(2 * np.pi * anatomy.radius_mm / edge_mm))
    return np.arange(columns) * 2 * np.pi / columns


def _space_rows(wall: Wall, bulbs: list[Bulb]) -> Array:
    """Arc lengths (M,) mm whose steps are one mesh edge of wall at the steepest angle."""
    anatomy = wall.anatomy
    place = np.arange(0.0, unrolled_length(anatomy), ROW_STEP_MM)
    if anatomy.closed_end:  # the pole itself, which the arange leaves out
        place = np.linspace(0.0, unrolled_length(anatomy), len(place) + 1)
    step, arc = place[1], arc_at(place, anatomy)
    radius, shift, _ = wall.evaluate(arc[:, None], np.linspace(0, 2 * np.pi, 60, endpoint=False)[None, :])
    along, inward = np.gradient(arc[:, None] + shift, step, axis=0), np.gradient(radius, step, axis=0)
    speed = np.hypot(along, inward).max(axis=1)
    for bulb in bulbs:
        near = np.abs(arc - bulb.site.arc_mm) * bulb.site.per_arc < bulb.profile.reach_mm
        across = np.linspace(-1, 1, 41) * bulb.profile.reach_mm / bulb.site.per_rad
        points, _, _ = _draw(wall, [bulb], arc[near], bulb.site.angle_rad + across)
        stretched = np.linalg.norm(np.gradient(points, step, axis=0), axis=-1).max(axis=1)
        speed[near] = np.maximum(speed[near], stretched)
    length = np.concatenate([[0.0], np.cumsum(0.5 * step * (speed[1:] + speed[:-1]))])
    rows = np.linspace(0, length[-1], max(8, round(length[-1] / anatomy.edge_mm)))
    return arc_at(np.interp(rows, length, place), anatomy)


def _draw(wall: Wall, bulbs: list[Bulb], arc: Array, angle: Array) -> tuple[Array, Array, tuple[Array, Array]]:
    """Points (M,N,3) mm, polyp cover (M,N), and arc length and angle on the wall that each point was moved from."""
    if not bulbs:
        sheet = arc[:, None], angle[None, :]
        return *wall(*sheet), sheet
    sheet_arc, sheet_angle = (np.array(a) for a in np.broadcast_arrays(arc[:, None], angle[None, :]))
    discs = []
    for bulb in bulbs:  # discs do not overlap: each point is moved once
        part, direction = bulb.part(arc[:, None], angle[None, :])
        inside = part < 1
        discs.append((bulb, inside, part[inside], direction[inside]))
        sheet_arc[inside], sheet_angle[inside] = bulb.gathered(part[inside], direction[inside])
    points, cover = wall(sheet_arc, sheet_angle)
    for bulb, inside, part, direction in discs:
        points[inside] = bulb.drawn_out(points[inside], part, direction)
        cover[inside] = np.maximum(cover[inside], bulb.cover(part))
    return points, cover, (sheet_arc, sheet_angle)


def grid_normals(points: Array) -> Floats:
    """Unit normals (M,N,3) of a grid of points (M,N,3), into the lumen."""
    along = np.gradient(points, axis=0)
    around = np.roll(points, -1, axis=1) - np.roll(points, 1, axis=1)
    normal = np.cross(along, around)
    for end, next_to_it in ((0, 1), (-1, -2)):
        if not np.ptp(points[end], axis=0).any():  # the pole of a blind end: a ring of no size has no normal
            normal[end] = normal[next_to_it].mean(axis=0)
    return (normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)).astype(np.float32)


def _with_apex(polyp: Polyp, sheet_arc: Array, sheet_angle: Array, points: Array) -> Polyp:
    """The polyp with `apex` set to the vertex nearest to its middle."""
    around = (
        np.angle(np.exp(1j * (sheet_angle - polyp.angle_rad))) * 20.0
    )  # mm; any lumen's radius gives the same nearest vertex
    middle = np.argmin(np.hypot(sheet_arc - polyp.arc_mm, around))
    x, y, z = (float(v) for v in points.reshape(-1, 3)[middle])
    return replace(polyp, apex=(x, y, z))


def _as_polyp(bulb: Bulb) -> Polyp:
    """Record of a polyp on a stalk."""
    head = float(bulb.profile.rho[bulb.profile.height > bulb.profile.neck_mm].max())
    return Polyp(bulb.site.arc_mm, bulb.site.angle_rad, head, bulb.profile.top_mm, kind="pedunculated")


def _as_diverticulum(bulb: Bulb) -> Diverticulum:
    """Record of a diverticulum; its mouth is measured half way down its rounded edge."""
    x, y, z = (float(v) for v in bulb.site.centre)
    mouth = bulb.profile.radius_at(0.5 * POUCH_FLARE_MM)
    return Diverticulum(bulb.site.arc_mm, bulb.site.angle_rad, mouth, bulb.profile.top_mm, (x, y, z))
