"""A wall that never rests: contractions, breathing, insufflation and the push of the scope's tip.

The displacement of a vertex at time t is the sum of four terms, each zero at rest; `amplitude_mm` A scales all:

- contractions: rings that travel towards the camera at `wave_speed_mm_s`, A * CONTRACTION towards the centreline, a
  Gaussian along the gut; they begin WAVE_FROM_MM ahead of the camera and fade out before they reach it;
- breathing: the whole gut is squeezed by A * SQUEEZE and shifted by A * SHIFT along a direction that the seed draws;
- insufflation: the whole gut is widened and narrowed by A * INFLATION;
- push: wall beside the tip is pushed outwards by A * PUSH, a Gaussian in space.

With `axis` and `arc` of each vertex (properties of mesh.ply) and the WallState of a frame (wall_motion.json) a reader
rebuilds that frame's wall by `displaced`, whose formula is in its docstring. The wall at rest is the reference.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from haustra.phantom.anatomy.colon import Colon, grid_normals
from haustra.phantom.config import TissueConfig
from haustra.phantom.motion.peristalsis import MovedWall

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
CONTRACTION, SQUEEZE, SHIFT, INFLATION, PUSH = 0.6, 0.1, 0.2, 0.15, 0.4  # of the amplitude, each one's peak
MOST_INWARD = 0.75  # of a vertex's distance from the centreline that contractions can take away
RING_MM = 10.0  # of the Gaussian along the gut; a ring contraction is one to three centimetres long
WAVE_FROM_MM, WAVE_TO_MM = 95.0, 12.0  # ahead of the camera, where a contraction begins and where it has faded out
WAVE_RAMP_MM = 20.0  # over which it rises and fades
WAVES_EVERY_S = 3.0
PUSH_MM = 10.0  # standard deviation of a push in space
PUSH_AHEAD_MM = 12.0  # of the camera, where the wall is pushed
PUSH_S, PUSHES_EVERY_S = 1.5, 5.0


@dataclass(frozen=True)
class WallState:
    """Motion of the wall at one time; all zero at rest."""

    rings: tuple[tuple[float, float], ...]  # (arc length of the middle mm, inward peak mm) of each contraction
    inward_mm: float  # squeeze by breathing less the widening by insufflation
    shift_mm: tuple[float, float, float]  # of the whole
    push_at_mm: tuple[float, float, float]  # middle of the push
    push_mm: tuple[float, float, float]  # displacement there


def displaced(vertices: Array, axis: Array, arc: Array, state: WallState) -> Array:
    """Vertices (V,3) mm of the wall in a state; `axis` (V,3) and `arc` (V,) are those of the vertices at rest.

    With r the distance of a vertex x from its axis point and n the unit direction from axis to vertex:

        d = inward + sum_k peak_k exp(-((arc - middle_k) / RING_MM)^2)
        x' = x - n m tanh(d / m) + shift + push exp(-|x - push_at|^2 / (2 PUSH_MM^2)),   m = MOST_INWARD r
    """
    outward = vertices - axis
    radius = np.maximum(np.linalg.norm(outward, axis=1), 1e-6)
    inward = np.full(len(vertices), state.inward_mm)
    for middle, peak in state.rings:
        inward += peak * np.exp(-(((arc - middle) / RING_MM) ** 2))
    most = MOST_INWARD * radius
    moved = vertices - outward * (most * np.tanh(inward / most) / radius)[:, None] + state.shift_mm
    away = ((vertices - state.push_at_mm) ** 2).sum(axis=1)
    return moved + np.exp(-away / (2 * PUSH_MM**2))[:, None] * state.push_mm


class LivingWall:
    """Motion of the wall over a film whose camera centres are `positions` (N,3) mm."""

    def __init__(self, colon: Colon, tissue: TissueConfig, positions: Array, fps: float, seed: int) -> None:
        self._colon, self._tissue, self._fps = colon, tissue, fps
        self._camera_arc = colon.line.arc[cKDTree(colon.line.points).query(positions)[1]]
        rng = np.random.default_rng([seed, 11])
        self._phases = rng.uniform(0, 2 * np.pi, 2)  # of breathing and insufflation
        heading = rng.standard_normal(3)
        self._shift_way = heading / np.linalg.norm(heading)
        seconds = len(positions) / fps
        self._waves = np.arange(rng.uniform(-WAVES_EVERY_S, 0), seconds, WAVES_EVERY_S)  # s, when each begins
        self._pushes = self._plan_pushes(positions, np.arange(rng.uniform(0, PUSHES_EVERY_S), seconds, PUSHES_EVERY_S))

    @cached_property
    def axis(self) -> Array:
        """Point of the centreline (V,3) mm that each vertex moves towards."""
        line, columns = self._colon.line, self._colon.points.shape[1]
        return np.repeat(line.at(np.clip(self._colon.arc, 0, line.arc[-1]))[0], columns, axis=0)

    @cached_property
    def arc(self) -> Array:
        """Arc length (V,) mm of each vertex."""
        return np.repeat(self._colon.arc, self._colon.points.shape[1])

    def vertex_properties(self) -> dict[str, Floats]:
        """Vertex properties (V,) of mesh.ply by which a reader can move the wall."""
        x, y, z = self.axis.T.astype(np.float32)
        return {"axis_x": x, "axis_y": y, "axis_z": z, "arc_mm": self.arc.astype(np.float32)}

    def state(self, frame: float) -> WallState:
        """State of the wall at a frame, which may lie between two."""
        size, time = self._tissue.amplitude_mm, frame / self._fps
        breath = np.sin(2 * np.pi * time / self._tissue.breath_s + self._phases[0])
        gas = np.sin(2 * np.pi * time / self._tissue.insufflation_s + self._phases[1])
        here = np.interp(frame, np.arange(len(self._camera_arc)), self._camera_arc)
        rings = [(here_mm, size * CONTRACTION * part) for here_mm, part in self._rings(time, float(here)) if part > 0]
        at, way = self._push(time)
        return WallState(
            tuple(rings),
            float(size * (SQUEEZE * breath - INFLATION * gas)),
            _triple(size * SHIFT * breath * self._shift_way),
            _triple(at),
            _triple(size * PUSH * way),
        )

    def wall(self, frame: float) -> MovedWall:
        """The wall at a frame, which may lie between two."""
        rest = self._colon.points
        points = displaced(rest.reshape(-1, 3).astype(float), self.axis, self.arc, self.state(frame))
        change = grid_normals(points.reshape(rest.shape)) - self._colon.normals
        return MovedWall(points.astype(np.float32), change.reshape(-1, 3).astype(np.float32))

    def record(self, frames: int) -> dict[str, Any]:
        """What wall_motion.json holds: constants of the formula and the state of each frame."""
        constants = {"ring_mm": RING_MM, "push_sigma_mm": PUSH_MM, "most_inward": MOST_INWARD}
        return constants | asdict(self._tissue) | {"frames": [asdict(self.state(i)) for i in range(frames)]}

    def _rings(self, time: float, camera_arc: float) -> list[tuple[float, float]]:
        """(arc length of the middle mm, strength 0 to 1) of each contraction. Each keeps its own course in the gut."""
        rings = []
        for begin in self._waves[self._waves <= time]:
            at_begin = float(np.interp(max(begin, 0) * self._fps, np.arange(len(self._camera_arc)), self._camera_arc))
            run = self._tissue.wave_speed_mm_s * (time - begin)
            middle = at_begin + WAVE_FROM_MM - run
            rise = min(run, middle - camera_arc - WAVE_TO_MM) / WAVE_RAMP_MM
            rings.append((middle, float(0.5 - 0.5 * np.cos(np.pi * np.clip(rise, 0, 1)))))
        return rings

    def _plan_pushes(self, positions: Array, begins: Array) -> list[tuple[float, Array, Array]]:
        """(begin s, middle (3,) mm, outward unit direction (3,)) of each push: wall beside the tip, a little ahead."""
        tree, plan = cKDTree(self._colon.vertices), []
        for begin in begins:
            frame = min(int((begin + PUSH_S / 2) * self._fps), len(positions) - 1)
            ahead = self._colon.line.at(np.array([self._camera_arc[frame] + PUSH_AHEAD_MM]))[0][0]
            beside = self._colon.line.at(np.array([self._camera_arc[frame]]))[0][0]
            vertex = tree.query(positions[frame] + ahead - beside)[1]
            outward = self._colon.vertices[vertex].astype(float) - self.axis[vertex]
            plan.append((float(begin), self._colon.vertices[vertex].astype(float), outward / np.linalg.norm(outward)))
        return plan

    def _push(self, time: float) -> tuple[Array, Array]:
        """Middle (3,) mm of the push at a time and its direction times its strength (3,); zero where none is."""
        for begin, at, outward in self._pushes:
            if begin <= time <= begin + PUSH_S:
                return at, outward * np.sin(np.pi * (time - begin) / PUSH_S) ** 2
        return np.zeros(3), np.zeros(3)


def _triple(values: Sequence[float] | Array) -> tuple[float, float, float]:
    x, y, z = (float(value) for value in values)
    return x, y, z
