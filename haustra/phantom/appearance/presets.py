"""Presets of mucosa and light for the named scenes.

Chosen by eye, beside pictures of the retired `phantom_likeness` benchmark; nothing was fitted to them.
"""

from __future__ import annotations

from dataclasses import replace

from haustra.phantom.config import AppearanceConfig, ImagingConfig

PINK = AppearanceConfig(
    tissue=(0.66, 0.24, 0.18),
    tissue_other=(0.72, 0.31, 0.22),
    blotch_mm=25.0,
    mottle=0.045,
    grain=0.008,
    erythema=0.2,
    vessel_colour=(0.50, 0.20, 0.20),
    mesh_vessels=0.8,
    mesh_cell_mm=9.0,
    mesh_width_mm=0.36,
    tree_vessels=0.45,
    trees_per_cm2=0.02,
    tree_width_mm=0.5,
    bump_mm=0.004,
    cavity=0.45,
    fluid=0.02,
)
SCOPE = ImagingConfig(
    ambient=0.012,
    bounce=1.3,
    wrap=0.3,
    specular=0.05,
    shininess=700.0,
    exposure=0.19,
    light_lobe=0.5,
    light_colour=(1.0, 0.96, 0.92),
    sharpen=0.15,
    chroma_px=2,
    defocus_px=0.35,
    focus_mm=22.0,
    noise=0.004,
    shutter=0.3,
    vignette=0.2,
)
VILLOUS = AppearanceConfig(
    tissue=(0.74, 0.32, 0.23),
    tissue_other=(0.76, 0.38, 0.25),
    blotch_mm=25.0,
    mottle=0.03,
    grain=0.006,
    erythema=0.12,
    mesh_vessels=0.0,
    tree_vessels=0.3,
    trees_per_cm2=0.03,
    tree_width_mm=0.35,
    bump_mm=0.003,
    cavity=0.5,
    fluid=0.04,
    fluid_colour=(0.95, 0.85, 0.45),
)
CAPSULE = replace(
    SCOPE, light_offset_mm=2.5, focus_mm=14.0, specular=0.04, shininess=60.0, exposure=0.19, sharpen=0.0, light_lobe=0.8
)
ORANGE = AppearanceConfig(
    tissue=(0.82, 0.36, 0.12),
    tissue_other=(0.88, 0.44, 0.16),
    blotch_mm=25.0,
    mottle=0.05,
    grain=0.008,
    erythema=0.1,
    vessel_colour=(0.6, 0.4, 0.4),
    mesh_vessels=0.0,
    tree_vessels=0.5,
    trees_per_cm2=0.12,
    tree_width_mm=0.35,
    bump_mm=0.008,
    cavity=0.4,
)
PALE = AppearanceConfig(
    tissue=(0.76, 0.40, 0.34),
    tissue_other=(0.80, 0.47, 0.39),
    blotch_mm=25.0,
    mottle=0.04,
    grain=0.008,
    erythema=0.2,
    vessel_colour=(0.6, 0.3, 0.32),
    mesh_vessels=0.35,
    mesh_cell_mm=10.0,
    tree_vessels=0.5,
    trees_per_cm2=0.06,
    tree_width_mm=0.5,
    bump_mm=0.006,
    cavity=0.4,
)
SPOT = ImagingConfig(
    lights=1,
    light_offset_mm=3.0,
    light_lobe=4.0,
    ambient=0.008,
    bounce=1.3,
    wrap=0.2,
    specular=0.05,
    shininess=500.0,
    exposure=0.18,
    vignette=0.4,
)
WIDE = ImagingConfig(
    lights=2,
    light_lobe=0.1,
    ambient=0.022,
    bounce=1.3,
    wrap=0.3,
    specular=0.04,
    shininess=400.0,
    exposure=0.30,
    vignette=0.1,
)
VEINED = AppearanceConfig(
    tissue=(0.60, 0.20, 0.14),
    tissue_other=(0.66, 0.26, 0.16),
    mottle=0.06,
    grain=0.01,
    erythema=0.35,
    vessel_colour=(0.40, 0.13, 0.14),
    mesh_vessels=0.5,
    mesh_cell_mm=7.0,
    mesh_width_mm=0.4,
    tree_vessels=0.85,
    trees_per_cm2=0.2,
    tree_width_mm=0.65,
    bump_mm=0.006,
    cavity=0.5,
)
DIM = ImagingConfig(
    lights=1,
    light_offset_mm=4.0,
    light_lobe=0.2,
    ambient=0.002,
    bounce=0.5,
    wrap=0.1,
    specular=0.05,
    shininess=600.0,
    exposure=0.06,
    noise=0.010,
    vignette=0.35,
    blur_px=0.7,
    chroma_px=2,
)
