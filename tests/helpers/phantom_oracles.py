"""A look without terms, to switch single ones on, and ray-triangle algebra for many rays."""

from __future__ import annotations

import numpy as np

from haustra.phantom.config import AppearanceConfig, ImagingConfig

BARE = ImagingConfig(
    lights=1,
    light_offset_mm=0.0,
    light_roll_deg=0.0,
    light_lobe=0.0,
    light_colour=(1.0, 1.0, 1.0),
    ambient=0.0,
    bounce=0.0,
    wrap=0.0,
    shadows=False,
    specular=0.0,
    exposure=0.2,
    exposure_smoothing=0.0,
    gamma=1.0,
    vignette=0.0,
    noise=0.0,
    blur_px=0.0,
)
COLOURLESS = AppearanceConfig(
    tissue=(0.5, 0.4, 0.3),
    tissue_other=(0.5, 0.4, 0.3),
    mottle=0.0,
    grain=0.0,
    erythema=0.0,
    mesh_vessels=0.0,
    tree_vessels=0.0,
    bump_mm=0.0,
    cavity=0.0,
    texel_mm=0.5,
)


def first_hits(origin: np.ndarray, directions: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """`first_hit` for many directions (N,3) from one origin: with it fixed, every term is linear in the direction."""
    a, edge1, edge2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    s = origin - a
    q, p = np.cross(s, edge1), np.cross(edge2, s)
    above = np.sum(edge2 * q, axis=1)
    length, which = np.empty(len(directions)), np.empty(len(directions), int)
    for part in range(0, len(directions), 512):
        rays = directions[part : part + 512]
        with np.errstate(divide="ignore", invalid="ignore"):
            inverse = 1 / (rays @ np.cross(edge2, edge1).T)
            u, v, t = rays @ p.T * inverse, rays @ q.T * inverse, above * inverse
        t[~((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0))] = np.inf
        which[part : part + 512], length[part : part + 512] = t.argmin(axis=1), t.min(axis=1)
    return length, which
