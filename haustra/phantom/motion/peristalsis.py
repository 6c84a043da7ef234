"""Peristalsis: a contraction that runs along the wall while the camera films it.

Every vertex moves towards the point of the centreline at its own row:

    vertex(t) = vertex + w(t) (axis - vertex),   w(t) = strength(t) exp(-((arc - centre(t)) / WIDTH_MM)^2)

with `axis` and `arc` of each vertex stored in the folder's mesh.ply and `centre`, `strength` of each frame in its
events.json, so that a reader rebuilds the wall of any frame exactly, without this package.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.phantom.anatomy.colon import Colon, grid_normals
from haustra.phantom.config import EventsConfig
from haustra.phantom.timeline import Slot

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
WIDTH_MM = 9.0  # of the Gaussian; a ring contraction is one to three centimetres long
AHEAD_MM = (65.0, 26.0)  # of the camera in arc length, where a contraction begins and where it ends
NEGLIGIBLE = 1e-3  # strength below which the wall counts as at rest


@dataclass(frozen=True)
class Contraction:
    """A contraction at one frame."""

    frame: int
    centre_mm: float  # arc length of its middle
    strength: float  # share of the radius that it removes there


class WallMotion(Protocol):
    """What moves the wall of a film."""

    def wall(self, frame: float) -> MovedWall | None:
        """The wall at a frame, which may lie between two; None where it is at rest."""

    def vertex_properties(self) -> dict[str, Floats]:
        """Vertex properties (V,) of mesh.ply by which a reader can move the wall."""


@dataclass(frozen=True)
class MovedWall:
    """The wall at one frame."""

    vertices: Floats  # (V,3) mm
    normal_change: Floats  # (V,3) difference of the normals from those at rest


class Peristalsis:
    """All contractions of a video. `positions` (N,3) mm are the camera centres."""

    def __init__(self, colon: Colon, events: EventsConfig, timeline: Sequence[Slot], positions: Array) -> None:
        self._colon = colon
        camera_arc = colon.line.arc[cKDTree(colon.line.points).query(positions)[1]]
        self.waves: dict[int, Contraction] = {}
        for slot in (slot for slot in timeline if slot.kind == "peristalsis"):
            begin = camera_arc[slot.first] + AHEAD_MM[0]
            end = camera_arc[slot.last] + AHEAD_MM[1]
            for frame in range(slot.first, slot.last + 1):
                strength = events.contraction * slot.strength(frame)
                centre = begin + (end - begin) * slot.part(frame)
                if strength > NEGLIGIBLE:
                    self.waves[frame] = Contraction(frame, float(centre), float(strength))

    @cached_property
    def axis(self) -> Array:
        """Point of the centreline (M,3) mm that each row of the mesh moves towards."""
        return self._colon.line.at(np.clip(self._colon.arc, 0, self._colon.line.arc[-1]))[0]

    def vertex_properties(self) -> dict[str, Floats]:
        """Vertex properties (V,) of mesh.ply by which a reader can move the wall."""
        columns = self._colon.points.shape[1]
        x, y, z = np.repeat(self.axis, columns, axis=0).T.astype(np.float32)
        arc = np.repeat(self._colon.arc, columns).astype(np.float32)
        return {"axis_x": x, "axis_y": y, "axis_z": z, "arc_mm": arc}

    def wall(self, frame: float) -> MovedWall | None:
        """The wall at a frame, that of the frame before where it lies between two; None where it is at rest."""
        wave = self.waves.get(int(frame))
        if wave is None:
            return None
        weight = wave.strength * np.exp(-(((self._colon.arc - wave.centre_mm) / WIDTH_MM) ** 2))
        rest = self._colon.points
        points = rest + weight[:, None, None] * (self.axis[:, None] - rest)
        change = grid_normals(points) - self._colon.normals
        return MovedWall(points.reshape(-1, 3).astype(np.float32), change.reshape(-1, 3).astype(np.float32))
