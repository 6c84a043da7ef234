"""The phantom against oracles that share none of its code: plain ray-triangle algebra, OpenCV's lenses, warping."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import trimesh
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from haustra.phantom.config import (
    CameraConfig,
    PhantomConfig,
)
from haustra.phantom.dataset.demo import DEMO
from haustra.phantom.dataset.generate import generate
from haustra.phantom.dataset.randomise import randomised
from haustra.phantom.dataset.shards import ShardPlan, write_shards
from haustra.phantom.imaging.camera import make_camera
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.camera_path import clearance, plan_camera_path
from tests.helpers.tiny_phantom import SIZE, TINY, corners_of, first_hit, pixel_direction


@pytest.fixture(scope="module")
def phantom() -> Phantom:
    return Phantom(TINY, threads=1)


@pytest.fixture(scope="module")
def poses(phantom: Phantom) -> np.ndarray:
    return plan_camera_path(phantom.colon, phantom.caster, TINY.motion, TINY.seed)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(TINY, tmp_path_factory.mktemp("phantom"), threads=1)


def test_depth_equals_brute_force_ray_casting(phantom: Phantom, poses: np.ndarray) -> None:
    frame = next(phantom.film(poses[:1]))
    corners, rng = corners_of(phantom), np.random.default_rng(0)
    for row, column in rng.integers(0, SIZE, (60, 2)):
        direction = poses[0, :3, :3] @ pixel_direction(phantom.camera, row, column)
        z, triangle = first_hit(poses[0, :3, 3], direction, corners)
        assert frame.depth[row, column] == pytest.approx(z if np.isfinite(z) else 0.0, abs=1e-3)
        assert frame.triangle[row, column] == (triangle if np.isfinite(z) else -1)


@pytest.mark.parametrize("model", ["PINHOLE", "OPENCV", "OPENCV_FISHEYE"])
def test_depth_is_ray_length_times_cosine(phantom: Phantom, poses: np.ndarray, model: str) -> None:
    bent = (0.0, 0.0, 0.0, 0.0) if model == "PINHOLE" else (-0.05, 0.01, 0.0, 0.0)
    view = phantom.seen_through(TINY.imaging, CameraConfig(model, SIZE, SIZE, 90.0, bent))
    frame = next(view.film(poses[:1]))
    hits = phantom.caster.cast(poses[0, :3, 3], view.rays @ poses[0, :3, :3].T)
    seen = frame.depth > 0
    assert np.mean(seen) > 0.9
    np.testing.assert_allclose(frame.depth[seen], (hits.length * view.rays[..., 2])[seen], rtol=1e-5)


def test_depth_and_pose_explain_the_next_frame(phantom: Phantom, poses: np.ndarray) -> None:
    size = 128
    view = phantom.seen_through(TINY.imaging, CameraConfig(width=size, height=size))
    now, then = view.film(poses[:2])
    fx, fy, cx, cy = view.camera.params
    x, y = np.meshgrid(np.arange(size) + 0.5, np.arange(size) + 0.5)
    points = np.stack([(x - cx) / fx, (y - cy) / fy, np.ones_like(x)], -1) * then.depth[..., None]
    now_from_then = np.linalg.inv(poses[0]) @ poses[1]
    moved = points @ now_from_then[:3, :3].T + now_from_then[:3, 3]
    u, v = fx * moved[..., 0] / moved[..., 2] + cx - 0.5, fy * moved[..., 1] / moved[..., 2] + cy - 0.5
    maps = u.astype(np.float32), v.astype(np.float32)
    warped = cv2.remap(now.image, *maps, cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE)
    inside = (u > 1) & (v > 1) & (u < size - 2) & (v < size - 2) & (then.depth > 0)
    error = np.abs(detail(warped) - detail(then.image))[inside].mean()
    standing_still = np.abs(detail(now.image) - detail(then.image))[inside].mean()
    assert error < 0.35 * standing_still  # half a pixel off in the lens would give 0.43, one pixel 0.68


def detail(image: np.ndarray) -> np.ndarray:
    """The image without its slow part: the light moves along with the camera, so brightness differs, texture not."""
    floats = image.astype(np.float32)
    return floats - cv2.GaussianBlur(floats, (0, 0), 3.0)


def test_same_seed_same_bytes(phantom: Phantom, poses: np.ndarray) -> None:
    again = Phantom(TINY, threads=2)
    np.testing.assert_array_equal(plan_camera_path(again.colon, again.caster, TINY.motion, TINY.seed), poses)
    for one, other in zip(phantom.film(poses), again.film(poses)):
        assert one.image.tobytes() == other.image.tobytes()
        assert one.depth.tobytes() == other.depth.tobytes()


def test_same_seed_same_folder(folder: Path, tmp_path: Path) -> None:
    generate(TINY, tmp_path, threads=2)
    files = [path.relative_to(folder) for path in sorted(folder.rglob("*")) if path.is_file()]
    assert len(files) == 2 * TINY.motion.frames + 8
    for name in files:
        assert (folder / name).read_bytes() == (tmp_path / name).read_bytes(), name


def test_another_seed_is_another_colon(phantom: Phantom) -> None:
    other = Phantom(replace(TINY, seed=6), threads=1)
    assert other.colon.vertices.shape != phantom.colon.vertices.shape or not np.allclose(
        other.colon.vertices, phantom.colon.vertices
    )


def test_folder_keeps_its_contract(folder: Path, phantom: Phantom, poses: np.ndarray) -> None:
    camera = json.loads((folder / "camera.json").read_text())
    assert camera["model"] == "PINHOLE"
    assert camera["depth_unit_mm"] == 0.01
    rows = np.loadtxt(folder / "trajectory.txt")
    np.testing.assert_allclose(rows[:, 1:4], poses[:, :3, 3], atol=1e-5)
    np.testing.assert_allclose(rows[:, 0], np.arange(4) / 30, atol=1e-6)
    assert PhantomConfig.from_dict(yaml.safe_load((folder / "config.yaml").read_text())) == TINY
    for index, frame in enumerate(phantom.film(poses)):
        depth = cv2.imread(str(folder / "depth" / f"{index:05d}.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_allclose(depth * 0.01, frame.depth, atol=0.0051)
        rgb = cv2.imread(str(folder / "rgb" / f"{index:05d}.png"))[..., ::-1]
        np.testing.assert_array_equal(rgb, frame.image)


def test_video_decodes_to_the_frames(folder: Path) -> None:
    with av.open(str(folder / "video.mp4")) as container:
        assert container.streams.video[0].codec_context.name == "h264"
        decoded = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
    assert len(decoded) == TINY.motion.frames
    truth = cv2.imread(str(folder / "rgb" / "00002.png"))[..., ::-1]
    assert np.abs(decoded[2].astype(float) - truth).mean() < 6.0


def test_seen_faces_equal_brute_force(tmp_path: Path, phantom: Phantom) -> None:
    small = replace(TINY, camera=CameraConfig(width=20, height=20), motion=replace(TINY.motion, frames=3))
    generate(small, tmp_path, threads=1)
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    data = mesh.metadata["_ply_raw"]["face"]["data"]
    seen, nearest_mm = data["seen"].ravel().astype(bool), data["nearest_mm"].ravel()
    corners, expected = corners_of(phantom), np.full(len(seen), np.inf)
    np.testing.assert_allclose(mesh.triangles, corners, atol=1e-5)
    poses, camera = (
        plan_camera_path(phantom.colon, phantom.caster, small.motion, small.seed),
        make_camera(small.camera),
    )
    for world_from_camera in poses:
        for row, column in np.ndindex(20, 20):
            direction = world_from_camera[:3, :3] @ pixel_direction(camera, row, column)
            z, triangle = first_hit(world_from_camera[:3, 3], direction, corners)
            expected[triangle] = min(expected[triangle], z)
    np.testing.assert_array_equal(seen, np.isfinite(expected))
    np.testing.assert_allclose(nearest_mm, expected, rtol=1e-5)


def test_mesh_faces_the_lumen_and_polyps_lie_on_it(phantom: Phantom) -> None:
    mesh = trimesh.Trimesh(phantom.colon.vertices, phantom.colon.triangles, process=False)
    assert mesh.is_winding_consistent
    assert mesh.euler_number == 0  # a tube, open at both ends
    centre = phantom.colon.line.points[20:-20:10]
    assert clearance(phantom.colon, phantom.caster, centre)[0].min() > 0
    apexes = np.array([polyp.apex for polyp in phantom.colon.polyps])
    assert np.abs(clearance(phantom.colon, phantom.caster, apexes)[0]).max() < 1e-3


LENS = st.tuples(*[st.floats(-0.03, 0.03)] * 2, *[st.floats(-0.002, 0.002)] * 2)


@given(k=LENS, seed=st.integers(0, 1000))
@settings(max_examples=25, deadline=None)
def test_fisheye_agrees_with_opencv(k: tuple[float, ...], seed: int) -> None:
    camera = make_camera(CameraConfig("OPENCV_FISHEYE", 320, 240, 130.0, k))
    rng = np.random.default_rng(seed)
    points = np.stack([*rng.uniform(-1.2, 1.2, (2, 40)), np.ones(40)], axis=1)
    pixels, _ = cv2.fisheye.projectPoints(points[:, None], np.zeros(3), np.zeros(3), camera.matrix, np.array(k))
    np.testing.assert_allclose(camera.project(points), pixels[:, 0], atol=1e-6)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.unproject(pixels[:, 0]), rays, atol=1e-7)


@given(k=st.tuples(st.floats(-0.05, 0.05), st.floats(0, 0.005), *[st.floats(-0.003, 0.003)] * 2))
@settings(max_examples=25, deadline=None)
def test_radial_lens_agrees_with_opencv(k: tuple[float, ...]) -> None:
    camera = make_camera(CameraConfig("OPENCV", 320, 240, 85.0, k))
    points = np.stack([*np.random.default_rng(0).uniform(-0.9, 0.9, (2, 40)), np.ones(40)], axis=1)
    pixels, _ = cv2.projectPoints(points, np.zeros(3), np.zeros(3), camera.matrix, np.array(k))
    np.testing.assert_allclose(camera.project(points), pixels[:, 0], atol=1e-6)
    rays = points / np.linalg.norm(points, axis=1, keepdims=True)
    np.testing.assert_allclose(camera.unproject(pixels[:, 0]), rays, atol=1e-6)


def test_a_lens_that_folds_over_is_refused() -> None:
    with pytest.raises(ValueError, match="folds over"):
        make_camera(CameraConfig("OPENCV", 64, 64, 110.0, (-0.2, 0.0, 0.0, 0.0))).rays()


@given(seed=st.integers(0, 10_000), direction=st.sampled_from(["withdrawal", "insertion"]))
@settings(max_examples=15, deadline=None)
def test_paths_are_rigid_smooth_and_clear_of_the_wall(phantom: Phantom, seed: int, direction: str) -> None:
    motion = replace(TINY.motion, frames=30, direction=direction, start=0.5, wobble_mm=9.0, look_deg=20.0)
    poses = plan_camera_path(phantom.colon, phantom.caster, motion, seed)
    turns = poses[:, :3, :3]
    np.testing.assert_allclose(turns @ turns.transpose(0, 2, 1), np.tile(np.eye(3), (30, 1, 1)), atol=1e-9)
    np.testing.assert_allclose(np.linalg.det(turns), 1.0, atol=1e-9)
    cosine = (np.einsum("nij,nij->n", turns[1:], turns[:-1]) - 1) / 2
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 10.0
    assert clearance(phantom.colon, phantom.caster, poses[:, :3, 3])[0].min() >= motion.clearance_mm


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=20, deadline=None)
def test_config_survives_yaml(seed: int) -> None:
    config = randomised(np.random.default_rng(seed))
    assert PhantomConfig.from_dict(yaml.safe_load(yaml.safe_dump(config.to_dict()))) == config


@pytest.mark.parametrize("values", [{"sed": 1}, {"camera": {"fov": 90.0}}, {"seed": "many"}])
def test_config_refuses_what_it_does_not_know(values: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=r"unknown|expected"):
        PhantomConfig.from_dict(values)


def shard_plan(folder: Path) -> ShardPlan:
    """Of two guts, the second with two frames."""
    return ShardPlan(folder, frames=22, size=24, seed=3, scene="small_intestine")


@pytest.fixture(scope="module")
def shards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Rendered in one go by one worker."""
    folder = tmp_path_factory.mktemp("shards")
    write_shards(shard_plan(folder), 1)
    return folder


def assert_same_shards(one: Path, other: Path) -> None:
    for name in ("images", "depths", "intrinsics", "colon"):
        np.testing.assert_array_equal(*(np.load(folder / f"{name}.npy") for folder in (one, other)))


def test_shards_do_not_depend_on_the_workers(tmp_path: Path, shards: Path) -> None:
    write_shards(shard_plan(tmp_path), 2)
    assert_same_shards(tmp_path, shards)
    assert np.load(shards / "colon.npy").tolist() == [0] * 20 + [1] * 2
    assert (np.load(shards / "depths.npy") > 0).mean() > 0.7


def test_a_stopped_call_keeps_the_colons_that_it_rendered(tmp_path: Path, shards: Path) -> None:
    plan = shard_plan(tmp_path)
    counts: list[int] = []

    def stop(done: int, of: int) -> None:
        counts.append(done)
        if len(counts) == 1:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_shards(plan, 1, stop)
    assert not (plan.folder / "shards.json").exists()
    write_shards(plan, 1, lambda done, of: counts.append(done))
    assert counts == [20, 22]
    assert {path.name for path in plan.folder.iterdir()} >= {"shards.json"}
    assert not (plan.folder / "unfinished.json").exists()
    assert_same_shards(tmp_path, shards)


def test_the_demo_has_the_advertised_lens() -> None:
    assert make_camera(DEMO.camera).params == pytest.approx((159.45, 159.45, 160.0, 160.0), abs=0.005)
