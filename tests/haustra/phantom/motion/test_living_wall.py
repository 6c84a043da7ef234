"""The living wall: it moves as its formula says, by as much as it is told, and can be rebuilt from the folder alone."""

from __future__ import annotations

import json
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from haustra.core.errors import PhantomError
from haustra.phantom.config import MotionConfig, PhantomConfig, TissueConfig
from haustra.phantom.dataset.checks import check
from haustra.phantom.dataset.generate import generate
from haustra.phantom.dataset.suite import LIVING_FILE, load_suite
from haustra.phantom.imaging.render import Phantom, camera_between
from haustra.phantom.imaging.scopes import filmed_through
from haustra.phantom.motion.camera_path import clearance
from haustra.phantom.motion.living_wall import LivingWall, displaced
from haustra.phantom.motion.recorded_path import read_recording, replay
from tests.helpers.tiny_phantom import SIZE, TINY, depth_errors

FPS = 10.0


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(TINY, threads=1)


def wall_of(phantom: Phantom, amplitude_mm: float, frames: int = 40, seed: int = 0) -> LivingWall:
    line = phantom.colon.line
    positions = line.at(np.full(frames, 0.3 * line.arc[-1]))[0]
    return LivingWall(phantom.colon, TissueConfig(amplitude_mm=amplitude_mm), positions, FPS, seed)


@pytest.mark.parametrize("amplitude_mm", [2.5, 5.0])
def test_no_wall_moves_farther_than_the_amplitude_and_some_moves_most_of_it(
    phantom: Phantom, amplitude_mm: float
) -> None:
    wall = wall_of(phantom, amplitude_mm)
    moved = [np.linalg.norm(wall.wall(f).vertices - phantom.colon.vertices, axis=1) for f in range(40)]
    assert np.max(moved) < 1.2 * amplitude_mm
    assert np.max(moved) > 0.5 * amplitude_mm


def test_the_camera_path_does_not_depend_on_the_motion_and_a_still_wall_has_none(phantom: Phantom) -> None:
    assert np.abs(wall_of(phantom, 0.0).wall(7).vertices - phantom.colon.vertices).max() < 1e-4


def test_two_walls_of_one_seed_are_one_and_of_two_seeds_two(phantom: Phantom) -> None:
    first, again, other = (wall_of(phantom, 5.0, seed=seed).wall(13).vertices for seed in (3, 3, 4))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 0.1


def test_the_wall_moves_smoothly_in_time(phantom: Phantom) -> None:
    wall = wall_of(phantom, 5.0)
    places = np.stack([wall.wall(frame).vertices for frame in np.arange(10, 20, 0.5)])
    steps = np.linalg.norm(np.diff(places, axis=0), axis=-1)
    bends = np.linalg.norm(np.diff(places, n=2, axis=0), axis=-1)
    assert steps.max() < 5.0 / FPS * 6  # 6 mm/s a mm of amplitude: a ring of 10 mm passes at 20 mm/s
    assert bends.max() < 0.8 * steps.max()


def test_contractions_travel_towards_the_camera_at_their_speed(phantom: Phantom) -> None:
    wall = wall_of(phantom, 5.0, frames=80)
    middles = [[middle for middle, _ in wall.state(frame).rings] for frame in range(80)]
    followed = [(a, b) for a, b in pairwise(middles) if len(a) == len(b) == 1]
    assert followed
    for (before,), (after,) in followed:
        assert before - after == pytest.approx(TissueConfig().wave_speed_mm_s / FPS)


@pytest.fixture(scope="module")
def moving(tmp_path_factory: pytest.TempPathFactory) -> tuple[PhantomConfig, Path]:
    motion = replace(TINY.motion, frames=6, speed_mm=0.2, fps=2.0, start=0.4)
    config = replace(TINY, motion=motion, tissue=TissueConfig(amplitude_mm=4.0))
    return config, generate(config, tmp_path_factory.mktemp("living"), threads=1)


def rebuilt(folder: Path, frame: int) -> tuple[np.ndarray, np.ndarray, trimesh.Trimesh]:
    """Vertices of the wall in a frame, by the documented formula from the folder's files, and the mesh at rest."""
    record = json.loads((folder / "wall_motion.json").read_text())
    state = record["frames"][frame]
    mesh = trimesh.load(folder / "mesh.ply", process=False)
    vertex = mesh.metadata["_ply_raw"]["vertex"]["data"]
    axis = np.stack([vertex[f"axis_{name}"].ravel() for name in "xyz"], axis=1).astype(float)
    arc = vertex["arc_mm"].ravel().astype(float)
    x = np.asarray(mesh.vertices, float)
    r = np.linalg.norm(x - axis, axis=1)
    n = (x - axis) / r[:, None]
    d = state["inward_mm"] + sum(p * np.exp(-(((arc - m) / record["ring_mm"]) ** 2)) for m, p in state["rings"])
    m = record["most_inward"] * r
    push = np.exp(-((x - state["push_at_mm"]) ** 2).sum(axis=1) / (2 * record["push_sigma_mm"] ** 2))
    moved = x - n * (m * np.tanh(d / m))[:, None] + state["shift_mm"] + push[:, None] * np.array(state["push_mm"])
    return moved, x, mesh


def test_depth_is_that_of_the_wall_rebuilt_from_the_folder_alone(moving: tuple[PhantomConfig, Path]) -> None:
    config, folder = moving
    camera = Phantom(config, threads=1).camera
    moved_by = []
    for frame in (1, 4):
        moved, rest, mesh = rebuilt(folder, frame)
        pixels = np.random.default_rng(0).integers(0, SIZE, (60, 2))
        errors, by = depth_errors(folder, frame, camera, pixels, moved[mesh.faces], rest[mesh.faces])
        moved_by += by
        assert np.quantile(errors, 0.95) < 0.006  # half a depth unit; a ray may slip past an edge in float32
    assert np.median(moved_by) > 0.1  # and the wall at rest would not explain the picture


def test_displaced_keeps_what_is_at_rest_and_never_crosses_the_centreline(phantom: Phantom) -> None:
    wall = wall_of(phantom, 20.0)
    vertices = phantom.colon.vertices.astype(float)
    state = replace(wall.state(20), shift_mm=(0.0, 0.0, 0.0), push_mm=(0.0, 0.0, 0.0))
    inward = ((displaced(vertices, wall.axis, wall.arc, state) - wall.axis) * (vertices - wall.axis)).sum(axis=1)
    assert (inward > 0).all()


def test_a_wall_that_always_moves_takes_no_peristalsis_beside_it() -> None:
    events = replace(TINY.events, peristalsis=1)
    with pytest.raises(PhantomError, match="peristalsis"):
        check(replace(TINY, events=events, tissue=TissueConfig(amplitude_mm=2.0)))


def recording(seconds: float, advance_mm: float) -> tuple[np.ndarray, np.ndarray]:
    """A camera that goes straight ahead along some direction, trembling, at 30 frames a second."""
    rng = np.random.default_rng(0)
    time = np.arange(0, seconds, 1 / 30)
    poses = np.tile(np.eye(4), (len(time), 1, 1))
    turn = Rotation.from_euler("xyz", [0.4, 1.0, -0.3]).as_matrix()
    tremble = Rotation.from_rotvec(0.01 * rng.standard_normal((len(time), 3))).as_matrix()
    poses[:, :3, :3] = turn @ tremble
    poses[:, :3, 3] = turn[:, 2] * np.linspace(0, advance_mm, len(time))[:, None] + [5, -90, 33]
    return time, poses


def test_a_recording_is_replayed_with_its_progress_its_tremor_and_clear_of_the_wall(phantom: Phantom) -> None:
    seconds, recorded = recording(4.0, 8.0)
    motion = MotionConfig(frames=100, fps=30.0, start=0.4, clearance_mm=2.0, ahead_mm=10.0)
    poses = replay(phantom.colon, phantom.caster, motion, seconds, recorded)
    way = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1).sum()
    assert way == pytest.approx(8.0 * 99 / 119, rel=0.2)  # 100 of its 120 frames; bends and pushes add a little
    turned = Rotation.from_matrix(np.swapaxes(poses[:-1, :3, :3], 1, 2) @ poses[1:, :3, :3]).magnitude()
    shaken = Rotation.from_matrix(np.swapaxes(recorded[:99, :3, :3], 1, 2) @ recorded[1:100, :3, :3]).magnitude()
    assert np.corrcoef(turned, shaken)[0, 1] > 0.9
    assert clearance(phantom.colon, phantom.caster, poses[:, :3, 3])[0].min() > 1.9


def test_a_recording_shorter_than_the_film_is_played_back(phantom: Phantom) -> None:
    seconds, recorded = recording(2.0, 4.0)
    motion = MotionConfig(frames=120, fps=30.0, start=0.4, clearance_mm=2.0, ahead_mm=10.0)
    centres = replay(phantom.colon, phantom.caster, motion, seconds, recorded)[:, :3, 3]
    there = np.linalg.norm(centres[59] - centres[0])
    assert np.linalg.norm(centres[118] - centres[0]) < 0.1 * there


@pytest.mark.parametrize("text", ["", "1 2 3\n" * 40, "no numbers\n", "0 0 0 0 0 0 0 1\n" * 40])
def test_what_is_no_recording_is_refused(tmp_path: Path, text: str) -> None:
    path = tmp_path / "path.txt"
    path.write_text(text)
    with pytest.raises(PhantomError, match=r"path\.txt"):
        read_recording(path)
    with pytest.raises(PhantomError, match="--recordings"):
        read_recording(tmp_path / "missing.txt")


def test_a_camera_between_two_frames_is_half_way_and_beyond_the_ends_goes_on() -> None:
    poses = np.tile(np.eye(4), (5, 1, 1))
    poses[:, 2, 3] = np.arange(5)
    poses[:, :3, :3] = Rotation.from_rotvec(np.radians([[0, 0, 10.0 * k] for k in range(5)])).as_matrix()
    for time in (0.5, 2.25, 4.5, 5, -1 / 3):
        between = camera_between(poses, time)
        assert between[2, 3] == pytest.approx(time)
        assert np.degrees(Rotation.from_matrix(between[:3, :3]).as_rotvec()[2]) == pytest.approx(10 * time)


@pytest.mark.parametrize("readout", ["interlaced", "sequential"])
def test_lines_and_colours_of_a_readout_in_parts_are_of_their_own_time(phantom: Phantom, readout: str) -> None:
    plain = replace(TINY.imaging, exposure_smoothing=0.0, fixed_gain=0.4, noise=0.0, blur_px=0.0, sharpen=0.0)
    film, slow = (Phantom(replace(TINY, imaging=replace(plain, readout=how)), 1) for how in (readout, "at_once"))
    line = phantom.colon.line
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[:, :3, 3] = line.at(np.array([0.40, 0.42, 0.44]) * line.arc[-1])[0]
    poses[:, :3, :3] = Rotation.align_vectors(
        [line.at(np.array([0.5 * line.arc[-1]]))[0][0] - poses[0, :3, 3]], [[0, 0, 1]]
    )[0].as_matrix()
    frame = list(film.film(poses))[1]
    times = {"interlaced": (1.0, 1.5), "sequential": (1.0, 2 / 3, 4 / 3)}[readout]
    parts = [next(iter(slow.film(camera_between(poses, time)[None]))).image for time in times]
    if readout == "interlaced":
        np.testing.assert_array_equal(frame.image[::2], parts[0][::2])
        np.testing.assert_array_equal(frame.image[1::2], parts[1][1::2])
    else:
        for channel, part in zip((1, 0, 2), parts):
            np.testing.assert_array_equal(frame.image[..., channel], part[..., channel])
    still = next(iter(slow.film(poses[1][None])))
    np.testing.assert_array_equal(frame.depth, still.depth)
    assert (frame.image != still.image).any()


@pytest.mark.parametrize("endoscope", range(1, 19))
def test_each_measured_scope_has_a_ray_for_every_pixel_that_its_mask_shows(endoscope: int) -> None:
    config = filmed_through(replace(TINY, camera=replace(TINY.camera, width=180, height=136)), endoscope)
    check(config)
    lens = np.array(config.camera.focal_px) * [1440 / 180, 1080 / 136]
    assert 700 < lens.min() < lens.max() < 810  # what EndoMapper measured, at its own size
    assert 1.8 < config.imaging.light_lobe < 3.4
    assert config.imaging.lobe_tilt_deg < 8.2


def test_the_lens_of_a_scope_is_opencv_s_fisheye() -> None:
    config = filmed_through(replace(TINY, camera=replace(TINY.camera, width=360, height=270)), 5)
    camera = Phantom(replace(TINY, camera=config.camera, imaging=config.imaging), 1).camera
    points = np.random.default_rng(0).uniform([-2, -2, 1], [2, 2, 3], (50, 3))
    distortion = np.array(config.camera.distortion)
    pixels, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.matrix, distortion)
    np.testing.assert_allclose(camera.project(points), pixels[:, 0], atol=1e-6)


def test_an_unknown_scope_is_refused() -> None:
    with pytest.raises(PhantomError, match="1 to 18"):
        filmed_through(TINY, 19)


def test_the_sweep_differs_in_the_motion_of_the_wall_alone() -> None:
    films = load_suite(LIVING_FILE)
    for path in "abc":
        still, *rest = (films[f"{path}_{size}"] for size in ("0.0", "2.5", "5.0", "10"))
        assert [film.tissue.amplitude_mm for film in (still, *rest)] == [0.0, 2.5, 5.0, 10.0]
        assert all(replace(film, tissue=still.tissue) == still for film in rest)
        assert still.motion.frames == 600
