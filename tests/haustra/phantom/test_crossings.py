"""No wall passes through itself: whole random meshes against Embree, profiles of the wall against plain segments."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from haustra.phantom.anatomy.centreline import grow_centreline
from haustra.phantom.anatomy.colon import build_colon
from haustra.phantom.anatomy.folds import Fold, place_folds
from haustra.phantom.anatomy.lesions import place_sessile
from haustra.phantom.anatomy.wall import Wall
from haustra.phantom.config import AnatomyConfig
from haustra.phantom.dataset.demo import DEMO
from haustra.phantom.dataset.randomise import randomised
from haustra.phantom.raycaster import _open3d


def pierced(vertices: np.ndarray, triangles: np.ndarray) -> int:
    """How often an edge of a mesh passes through a triangle that it shares no corner with."""
    core, geometry = _open3d().core, _open3d().t.geometry
    places, merged = np.unique(vertices, axis=0, return_inverse=True)  # the pole of a blind end is a ring of copies
    corners = merged.reshape(-1)[triangles]
    corners = corners[(corners != np.roll(corners, 1, axis=1)).all(axis=1)]
    pairs = np.concatenate([corners[:, [0, 1]], corners[:, [1, 2]], corners[:, [2, 0]]])
    edges = np.unique(np.sort(pairs, axis=1), axis=0)
    scene = geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(core.Tensor(places.astype(np.float32)), core.Tensor(corners.astype(np.uint32)))
    rays = np.concatenate([places[edges[:, 0]], places[edges[:, 1]] - places[edges[:, 0]]], axis=1)
    found = scene.list_intersections(core.Tensor(rays.astype(np.float32)), nthreads=1)
    part, edge, triangle = (found[key].numpy() for key in ("t_hit", "ray_ids", "primitive_ids"))
    inside = (part > 1e-3) & (part < 1 - 1e-3)
    edge, triangle = edges[edge[inside].astype(int)], corners[triangle[inside].astype(int)]
    return int((edge[:, :, None] != triangle[:, None, :]).all(axis=(1, 2)).sum())


def test_the_oracle_counts_edges_through_a_plate() -> None:
    plate = np.array([[-3, -3, 0], [3, -3, 0], [0, 4, 0]], float)
    blade = np.array([[0, 0, -1], [0, 0, 1], [0.5, 0, 1]], float)
    triangles = np.array([[0, 1, 2], [3, 4, 5]])
    assert pierced(np.concatenate([plate, blade]), triangles) == 2
    assert pierced(np.concatenate([plate, blade + np.array([0, 0, 1.5])]), triangles) == 0


RANDOM = [(50, 0.5), (56, 0.5), (75, 0.0), (81, 0.0), (3, 0.0), (8, 0.0), (38, 0.3), (51, 0.0), (10, 0.3), (27, 0.5)]
RANDOM += [(93, 0.0), (16, 0.4)]


@pytest.mark.parametrize(("seed", "collapse"), RANDOM)
def test_random_guts_do_not_pass_through_themselves(seed: int, collapse: float) -> None:
    """The first four did when folds leant as far as they were drawn to."""
    drawn = randomised(np.random.default_rng(seed))
    colon = build_colon(replace(drawn.anatomy, collapse=collapse, edge_mm=2.2), drawn.seed)
    assert pierced(colon.vertices, colon.triangles) == 0


LEANING = st.builds(
    AnatomyConfig,
    length_mm=st.just(120.0),
    radius_mm=st.floats(9.0, 29.0),
    fold_spacing_mm=st.floats(5.0, 40.0),
    fold_spacing_jitter=st.floats(0.1, 0.5),
    fold_depth_mm=st.floats(1.0, 14.0),
    fold_depth_jitter=st.floats(0.1, 0.6),
    fold_width_mm=st.floats(0.9, 4.5),
    fold_edge_mm=st.floats(0.6, 1.6),
    fold_tilt_mm=st.floats(0.0, 8.0),
    fold_lean=st.floats(0.3, 2.0),
    closed_start=st.booleans(),
    closed_end=st.booleans(),
    scene=st.sampled_from(["colon", "small_intestine"]),
)


# A leaning rim cut off where the lumen is narrowest, near a blind end: its loop is 0.3 mm long.
CUT_RIM = AnatomyConfig(
    length_mm=120.0,
    radius_mm=9.0,
    fold_spacing_mm=18.0,
    fold_spacing_jitter=0.5,
    fold_depth_mm=4.0,
    fold_depth_jitter=0.5,
    fold_width_mm=1.0,
    fold_edge_mm=1.0,
    fold_tilt_mm=0.0,
    fold_lean=1.0,
    closed_start=True,
    scene="small_intestine",
)


def grown(anatomy: AnatomyConfig, seed: int) -> tuple[Wall, list[Fold]]:
    """A wall, and its folds as they were drawn."""
    rng = np.random.default_rng(seed)
    line, folds = grow_centreline(anatomy, rng), place_folds(anatomy, rng)
    return Wall(anatomy, line, folds, place_sessile(anatomy, rng), rng, np.random.default_rng([seed, 1])), folds


def crosses_itself(curve: np.ndarray) -> bool:
    """True if two segments of a polyline (K,2) that do not follow each other cross: each parts the other's ends."""
    step, offset = np.diff(curve, axis=0)[:, None], curve[None] - curve[:-1, None]
    side = np.sign(step[..., 0] * offset[..., 1] - step[..., 1] * offset[..., 0])  # (K-1,K): of line, each point
    parts = side[:, 1:] * side[:, :-1] < 0
    return bool(np.triu(parts & parts.T, 2).any())


def test_the_oracle_tells_a_loop_from_an_overhang() -> None:
    assert crosses_itself(np.array([[0, 0], [2, 0], [1, 1], [1, -1]], float))
    assert not crosses_itself(np.array([[0, 0], [2, 0], [1, 1], [3, 1]], float))


@example(anatomy=CUT_RIM, seed=128, turn=0.0)
@given(anatomy=LEANING, seed=st.integers(0, 10_000), turn=st.floats(0.0, 1.0))
@settings(max_examples=15, deadline=None)
def test_the_wall_is_a_simple_curve_at_every_angle(anatomy: AnatomyConfig, seed: int, turn: float) -> None:
    """Half planes of unlike angles share the centreline only: a wall that is simple in each never meets itself."""
    wall, drawn = grown(anatomy, seed)
    arc = 0.5 * anatomy.length_mm * (1 - np.cos(np.linspace(0, np.pi, 500)))  # blind ends need the finer steps
    angle = 2 * np.pi * (np.arange(8) + turn) / 8
    radius, shift, _ = wall.evaluate(arc[:, None], angle[None, :])
    for column in range(len(angle)):
        assert not crosses_itself(np.stack([arc + shift[:, column], radius[:, column]], axis=1))
    assert [replace(fold, lean=0.0) for fold in wall.folds] == [replace(fold, lean=0.0) for fold in drawn]
    for now, before in zip(wall.folds, drawn):
        assert 0 <= now.lean * np.sign(before.lean) <= abs(before.lean)


def test_folds_that_have_room_lean_as_drawn() -> None:
    wall, drawn = grown(DEMO.anatomy, DEMO.seed)
    assert wall.folds == drawn
    crowded, drawn = grown(replace(DEMO.anatomy, fold_lean=2.0, fold_spacing_mm=12.0), DEMO.seed)
    assert crowded.folds != drawn
