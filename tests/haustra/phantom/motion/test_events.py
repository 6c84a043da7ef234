"""Events: they hide wall where the picture changes, leave truth alone elsewhere, and the moving wall can be rebuilt."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from haustra.phantom.config import EventsConfig, PhantomConfig
from haustra.phantom.dataset.generate import generate, is_finished
from haustra.phantom.imaging.forceps import _ray_capsule
from haustra.phantom.imaging.render import Frame, Phantom
from haustra.phantom.motion.camera_path import plan_camera_path
from haustra.phantom.motion.peristalsis import Peristalsis
from haustra.phantom.timeline import Slot, plan_timeline
from tests.helpers.tiny_phantom import SIZE, TINY, depth_errors

KINDS = ("red_out", "water_jet", "bubbles", "tool")
FRAMES = 12


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(TINY, threads=1)


@pytest.fixture(scope="module")
def poses(phantom: Phantom) -> np.ndarray:
    motion = replace(TINY.motion, frames=FRAMES, speed_mm=0.2)
    return plan_camera_path(phantom.colon, phantom.caster, motion, TINY.seed)


@pytest.fixture(scope="module")
def clean(phantom: Phantom, poses: np.ndarray) -> list[Frame]:
    return list(phantom.film(poses))


@pytest.mark.parametrize("kind", KINDS)
def test_truth_is_withdrawn_where_the_wall_is_hidden_and_nowhere_else(
    phantom: Phantom, poses: np.ndarray, clean: list[Frame], kind: str
) -> None:
    film = list(phantom.film(poses, [Slot(kind, 2, 10, 0)]))
    for index in (0, 1, 11):
        np.testing.assert_array_equal(film[index].depth, clean[index].depth)
    middle, before = film[6], clean[6]
    hidden = (middle.depth == 0) & (before.depth > 0)
    assert hidden.mean() > (0.99 if kind == "red_out" else 0.01)
    np.testing.assert_array_equal(middle.depth[~hidden], before.depth[~hidden])
    np.testing.assert_array_equal(middle.triangle[hidden], -1)
    if kind == "red_out":
        assert middle.image[..., 0].mean() > 2 * middle.image[..., 1].mean()
        return
    assert hidden.mean() < 0.6
    changed = np.abs(middle.image.astype(int) - before.image).max(axis=-1)
    assert changed[hidden].mean() > 3 * changed[~hidden].mean()  # the gain adapts, so all may change a little


@pytest.mark.parametrize("kind", KINDS)
def test_events_do_not_depend_on_threads_or_on_what_was_filmed_before(
    phantom: Phantom, poses: np.ndarray, kind: str
) -> None:
    slots = [Slot(kind, 2, 10, 3)]
    one = [frame.image.tobytes() for frame in phantom.film(poses, slots)]
    phantom_on_two = Phantom(TINY, threads=2)
    assert [frame.image.tobytes() for frame in phantom_on_two.film(poses, slots)] == one


def test_forceps_equals_marching_along_the_ray() -> None:
    rng = np.random.default_rng(0)
    start, end, radius = np.array([3.0, 4.0, -2.0]), np.array([0.5, 1.0, 12.0]), 1.2
    rays = rng.normal(size=(4000, 3)) * (0.4, 0.4, 0.0) + (0, 0, 1.0)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    found = _ray_capsule(rays, start, end, radius)
    lengths = np.arange(0, 16, 0.002)
    axis = end - start
    for ray, t in zip(rays[:300], found[:300]):
        places = lengths[:, None] * ray
        part = np.clip((places - start) @ axis / (axis @ axis), 0, 1)
        inside = np.linalg.norm(places - start - part[:, None] * axis, axis=1) < radius
        expected = lengths[inside.argmax()] if inside.any() else np.inf
        assert t == pytest.approx(expected, abs=0.02) or (np.isinf(expected) and t > 15)
    assert 0.02 < np.isfinite(found).mean() < 0.9


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> tuple[PhantomConfig, Path]:
    motion = replace(TINY.motion, frames=10, speed_mm=0.2, fps=10.0, start=0.4)
    config = replace(TINY, motion=motion, events=EventsConfig(peristalsis=1, duration_s=0.6))
    return config, generate(config, tmp_path_factory.mktemp("peristalsis"), threads=1)


def test_the_moving_wall_can_be_rebuilt_from_the_folder_alone(moving: tuple[PhantomConfig, Path]) -> None:
    config, folder = moving
    waves = json.loads((folder / "events.json").read_text())["contractions"]
    mesh = trimesh.load(folder / "mesh.ply", process=False)
    vertex = mesh.metadata["_ply_raw"]["vertex"]["data"]
    axis = np.stack([vertex[f"axis_{name}"].ravel() for name in "xyz"], axis=1).astype(float)
    strongest = max(waves, key=lambda wave: wave["strength"])
    apart = ((vertex["arc_mm"].ravel() - strongest["centre_mm"]) / strongest["width_mm"]).astype(float)
    weight = strongest["strength"] * np.exp(-(apart**2))
    moved = mesh.vertices + weight[:, None] * (axis - mesh.vertices)
    corners, rest = moved[mesh.faces], np.array(mesh.triangles)
    frame = strongest["frame"]
    camera = Phantom(config, threads=1).camera
    pixels = np.random.default_rng(0).integers(0, SIZE, (80, 2))
    errors, moved_by = depth_errors(folder, frame, camera, pixels, corners, rest)
    assert np.quantile(errors, 0.97) < 0.006  # half a depth unit; a ray may slip past an edge in float32
    assert np.max(moved_by) > 1.0  # and the wall at rest would not explain the picture


def test_the_wall_at_rest_when_no_wave_passes(phantom: Phantom) -> None:
    positions = np.tile(phantom.colon.line.points[40], (30, 1))
    events = EventsConfig(peristalsis=1, duration_s=0.5)
    timeline = plan_timeline(replace(TINY.motion, frames=30), events, 0)
    peristalsis = Peristalsis(phantom.colon, events, timeline, positions)
    (slot,) = timeline
    assert peristalsis.wall(slot.first - 1) is None
    assert peristalsis.wall((slot.first + slot.last) // 2) is not None
    assert set(peristalsis.waves) <= set(range(slot.first, slot.last + 1))


def test_an_unfinished_folder_is_not_called_finished(moving: tuple[PhantomConfig, Path], tmp_path: Path) -> None:
    config, folder = moving
    assert is_finished(folder, config)
    assert not is_finished(folder, replace(config, seed=9))
    assert not is_finished(tmp_path, config)
