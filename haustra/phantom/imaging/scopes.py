"""Eighteen real colonoscopes: the lens and lamp that EndoMapper measured, put before a phantom."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np

import haustra.core.errors
from haustra.core.errors import PhantomError
from haustra.phantom.config import PhantomConfig

TABLE = Path(haustra.core.errors.__file__).with_name("endomapper_scopes.json")


def filmed_through(config: PhantomConfig, endoscope: int) -> PhantomConfig:
    """The same phantom through the lens and under the lamp of an endoscope (1 to 18), at the config's picture size.

    The picture keeps the whole field of view; a round mask covers the corners, where these lenses have none.
    PhantomError if the number is unknown.
    """
    table = json.loads(TABLE.read_text())
    rows = {row["endoscope"]: row for row in table["scopes"]}
    if endoscope not in rows:
        raise PhantomError(f"scope: no endoscope {endoscope!r}; known: 1 to {len(rows)}")
    fx, fy, cx, cy, *distortion = rows[endoscope]["params"]
    x, y, z = rows[endoscope]["lamp_axis"]
    camera = config.camera
    wide, high = camera.width / table["width"], camera.height / table["height"]
    lens = replace(
        camera,
        model="OPENCV_FISHEYE",
        focal_px=(fx * wide, fy * high),
        centre_px=(cx * wide, cy * high),
        distortion=tuple(distortion),
    )
    lamp = replace(
        config.imaging,
        border="circle",
        light_lobe=float(rows[endoscope]["lamp_exponent"]),
        lobe_tilt_deg=float(np.degrees(np.arctan2(np.hypot(x, y), z))),
        lobe_roll_deg=float(np.degrees(np.arctan2(y, x))),
        gamma=table["gamma"],
    )
    return replace(config, camera=lens, imaging=lamp)
