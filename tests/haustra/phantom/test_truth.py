"""The phantom's truth against ray-triangle algebra in float64, OpenCV's lenses and PyAV, from the folder's files."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from pathlib import Path

import av
import cv2
import numpy as np
import pytest
import trimesh

from haustra.phantom.config import CameraConfig, EventsConfig, MotionConfig
from haustra.phantom.dataset.generate import generate
from haustra.phantom.imaging.camera import Camera, make_camera
from haustra.phantom.imaging.render import Phantom
from haustra.phantom.motion.camera_path import plan_camera_path
from tests.helpers.phantom_oracles import first_hits
from tests.helpers.tiny_phantom import TINY, corners_of, first_hit

MATT = replace(TINY.imaging, shadows=False)
LESIONS = replace(TINY, anatomy=replace(TINY.anatomy, radius_mm=17.0, polyps=1, pedunculated=1, diverticula=1), seed=4)
LENSES = {
    "PINHOLE": CameraConfig("PINHOLE", 60, 44, 95.0),
    "OPENCV": CameraConfig("OPENCV", 60, 44, 80.0, (-0.05, 0.008, 0.004, -0.003)),
    "OPENCV_FISHEYE": CameraConfig("OPENCV_FISHEYE", 60, 44, 120.0, (0.03, -0.01, 0.002, -0.0005)),
}


def directions_of(camera: Camera, pixels: np.ndarray) -> np.ndarray:
    """Directions (N,3) with z = 1 of pixels (N,2), by OpenCV from the file's parameters, checked by projecting back."""
    fx, fy, cx, cy = camera.params[:4]
    matrix, bent = np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1.0]]), np.array([*camera.params[4:], 0, 0, 0, 0])[:4]
    module = cv2.fisheye if camera.model == "OPENCV_FISHEYE" else cv2
    directions = np.ones((len(pixels), 3))
    directions[:, :2] = module.undistortPoints(pixels[:, None].astype(float), matrix, bent)[:, 0]
    for _ in range(60):  # it stops early: go on with what its own projection leaves
        back = module.projectPoints(directions[:, None], np.zeros(3), np.zeros(3), matrix, bent)[0][:, 0]
        directions[:, :2] += (pixels - back) / (fx, fy)
    np.testing.assert_allclose(back, pixels, atol=1e-6)
    return directions


def looking_at(eye: np.ndarray, target: np.ndarray) -> np.ndarray:
    forward = (target - eye) / np.linalg.norm(target - eye)
    right = np.cross([0.1, 1.0, 0.2], forward)
    right /= np.linalg.norm(right)
    world_from_camera = np.eye(4)
    world_from_camera[:3, :3], world_from_camera[:3, 3] = (
        np.stack([right, np.cross(forward, right), forward], axis=1),
        eye,
    )
    return world_from_camera


def share_an_edge(one: np.ndarray, other: np.ndarray) -> bool:
    return len(set(one.tolist()) & set(other.tolist())) >= 2


@pytest.fixture(scope="module")
def lesions() -> Phantom:
    return Phantom(LESIONS, threads=1)


@pytest.mark.parametrize("lens", LENSES)
def test_depth_is_brute_force_through_opencvs_lens(lesions: Phantom, lens: str) -> None:
    view = lesions.seen_through(MATT, LENSES[lens])
    colon, corners, rng = lesions.colon, corners_of(lesions), np.random.default_rng(0)
    stalked = next(polyp for polyp in colon.polyps if polyp.kind == "pedunculated")
    (pouch,) = colon.diverticula
    poses = [*plan_camera_path(colon, lesions.caster, replace(TINY.motion, frames=3), 4)]
    for arc, target in ((stalked.arc_mm, np.array(stalked.apex)), (pouch.arc_mm, np.array(pouch.centre))):
        eye = colon.line.at(np.array(arc))[0]
        poses.append(looking_at(eye + 0.2 * (target - eye), target))
    compared = 0
    for world_from_camera in poses:
        look = view.look(world_from_camera, world_from_camera)
        column, row = rng.integers(0, view.camera.width, 500), rng.integers(0, view.camera.height, 500)
        directions = directions_of(view.camera, np.stack([column, row], axis=1) + 0.5) @ world_from_camera[:3, :3].T
        wanted, triangle = first_hits(world_from_camera[:3, 3], directions, corners)
        single = first_hit(world_from_camera[:3, 3], directions[0], corners)
        assert (wanted[0], triangle[0]) == (pytest.approx(single[0], rel=1e-12), single[1])
        got, which = look.wall[row, column], look.triangle[row, column]
        np.testing.assert_array_equal(got > 0, np.isfinite(wanted))
        seen = got > 0
        for ours, theirs in zip(which[seen & (which != triangle)], triangle[seen & (which != triangle)]):
            assert share_an_edge(colon.triangles[ours], colon.triangles[theirs])  # grazes their common edge
        same = seen & (which == triangle)
        assert same.sum() > 0.97 * seen.sum() > 400
        assert np.abs(got - wanted)[same].max() < 1e-3
        compared += int(same.sum())
    assert compared > 2000


@pytest.mark.parametrize("lens", LENSES)
def test_the_horizontal_view_is_as_wide_as_asked(lens: str) -> None:
    camera, half = make_camera(LENSES[lens]), np.radians(LENSES[lens].fov_deg) / 2
    straight = replace(LENSES[lens], distortion=(*LENSES[lens].distortion[:2], 0.0, 0.0))  # tangential terms tilt
    camera = make_camera(straight) if lens == "OPENCV" else camera
    edge = directions_of(camera, np.array([[0.0, camera.height / 2], [camera.width, camera.height / 2]]))
    np.testing.assert_allclose(np.arctan2(edge[:, 0], edge[:, 2]), [-half, half], atol=1e-6)
    np.testing.assert_allclose(edge[:, 1], 0, atol=1e-9)


EVENTFUL = replace(
    TINY,
    anatomy=replace(TINY.anatomy, edge_mm=2.5, length_mm=100.0),
    imaging=replace(TINY.imaging, text=True, border="octagon"),
    camera=CameraConfig("OPENCV", 128, 32, 80.0, (-0.03, 0.004, 0.0, 0.0)),
    motion=MotionConfig(frames=11, fps=12.5, start=0.25, direction="insertion", speed_mm=1.0, wobble_mm=1.0),
    events=EventsConfig(tools=1, peristalsis=1, duration_s=0.32, contraction=0.4),
)


@pytest.fixture(scope="module")
def eventful(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return generate(EVENTFUL, tmp_path_factory.mktemp("eventful"), threads=1)


def depth_of(folder: Path, frame: int) -> np.ndarray:
    return cv2.imread(str(folder / "depth" / f"{frame:05d}.png"), cv2.IMREAD_UNCHANGED) * 0.01


class Files:
    """All that a reader knows: the mesh at rest, how it moves, the lens and the poses."""

    def __init__(self, folder: Path) -> None:
        self.mesh = trimesh.load(folder / "mesh.ply", process=False)
        self.face = self.mesh.metadata["_ply_raw"]["face"]["data"]
        vertex = self.mesh.metadata["_ply_raw"]["vertex"]["data"]
        self.axis = np.stack([vertex[f"axis_{name}"].ravel() for name in "xyz"], axis=1).astype(float)
        self.arc = vertex["arc_mm"].ravel().astype(float)
        record = json.loads((folder / "camera.json").read_text())
        self.camera = Camera(record["model"], record["width"], record["height"], tuple(record["params"]))
        self.waves = json.loads((folder / "events.json").read_text())["contractions"]
        self.rows = np.loadtxt(folder / "trajectory.txt")
        y, x = np.mgrid[: self.camera.height, : self.camera.width] + 0.5
        self.directions = directions_of(self.camera, np.stack([x.ravel(), y.ravel()], axis=1))

    def wall(self, frame: int) -> np.ndarray:
        """Corners (F,3,3) of the wall at a frame."""
        vertices = np.array(self.mesh.vertices, float)
        for wave in (wave for wave in self.waves if wave["frame"] == frame):
            weight = wave["strength"] * np.exp(-(((self.arc - wave["centre_mm"]) / wave["width_mm"]) ** 2))
            vertices += weight[:, None] * (self.axis - vertices)
        return vertices[self.mesh.faces]

    @cache  # noqa: B019
    def hits(self, frame: int, moved: bool = True) -> tuple[np.ndarray, np.ndarray]:
        """Depth (H,W), infinite where nothing is hit, and triangle (H,W), by brute force."""
        row = self.rows[frame]
        corners = self.wall(frame) if moved else np.array(self.mesh.triangles, float)
        z, triangle = first_hits(row[1:4], self.directions @ self.world_from_camera(frame)[:3, :3].T, corners)
        shape = self.camera.height, self.camera.width
        return z.reshape(shape), triangle.reshape(shape)

    def world_from_camera(self, frame: int) -> np.ndarray:
        row = self.rows[frame]
        world_from_camera = trimesh.transformations.quaternion_matrix([row[7], *row[4:7]])
        world_from_camera[:3, 3] = row[1:4]
        return world_from_camera


@pytest.fixture(scope="module")
def files(eventful: Path) -> Files:
    return Files(eventful)


def test_every_depth_of_the_moving_wall_follows_from_the_files(eventful: Path, files: Files) -> None:
    """And `seen` and `nearest_mm` are those of all frames, with text, mask, tool and a contraction in the way."""
    nearest, moved_by = np.full(len(files.mesh.faces), np.inf), 0.0
    for frame in range(EVENTFUL.motion.frames):
        depth = depth_of(eventful, frame)
        z, triangle = files.hits(frame)
        shown = depth > 0
        assert np.isfinite(z[shown]).all()
        error = np.abs(depth - z)[shown]
        assert error.max() < 0.005 + 1e-3, frame  # half a depth unit
        np.minimum.at(nearest, triangle[shown], z[shown])
        if frame == max(files.waves, key=lambda wave: wave["strength"])["frame"]:
            rest, _ = files.hits(frame, moved=False)
            moved_by = max(moved_by, float(np.abs(rest - depth)[shown & np.isfinite(rest)].max()))
    assert moved_by > 1.0  # the wall at rest would not do
    np.testing.assert_array_equal(files.face["seen"].ravel(), np.isfinite(nearest))
    np.testing.assert_allclose(files.face["nearest_mm"].ravel(), nearest, rtol=1e-5, atol=1e-3)
    assert 0.05 < np.isfinite(nearest).mean() < 0.95


def test_depth_is_missing_under_text_mask_and_tool_and_nowhere_else(eventful: Path, files: Files) -> None:
    plain = Phantom(replace(EVENTFUL, imaging=replace(EVENTFUL.imaging, text=False)), threads=1)
    height, width = files.camera.height, files.camera.width
    y, x = np.mgrid[:height, :width] + 0.5
    octagon = np.abs(x / width - 0.5) * 2 + np.abs(y / height - 0.5) * 2 < 1.45
    missing = np.stack([depth_of(eventful, frame) == 0 for frame in range(EVENTFUL.motion.frames)])
    assert missing[:, ~octagon].all()
    slots = json.loads((eventful / "events.json").read_text())["slots"]
    tool = next(slot for slot in slots if slot["kind"] == "tool")
    with_tool = range(tool["first_frame"], tool["last_frame"] + 1)
    written = np.all(missing, axis=0) & octagon
    assert 0.005 < written.mean() < 0.3  # where text stands the wall is never seen
    finite = np.stack([np.isfinite(files.hits(f)[0]) for f in range(EVENTFUL.motion.frames)])
    extra = missing & octagon & ~written & finite
    assert [bool(extra[frame].any()) for frame in range(len(extra)) if frame not in with_tool] == [False] * (
        len(extra) - len(with_tool)
    )
    assert extra[(with_tool[0] + with_tool[-1]) // 2].mean() > 0.005
    letters = cv2.imread(str(eventful / "rgb" / "00000.png"))[..., ::-1].astype(int)
    bare = next(plain.film(files.world_from_camera(0)[None])).image.astype(int)
    changed = np.abs(letters - bare).max(axis=-1) > 40
    assert changed.any()
    assert not (changed & ~missing[0]).any()


def test_seconds_are_frames_over_the_frame_rate(eventful: Path, files: Files) -> None:
    slots = json.loads((eventful / "events.json").read_text())["slots"]
    assert {slot["kind"] for slot in slots} == {"tool", "peristalsis"}
    for slot in slots:
        assert slot["first_s"] == pytest.approx(slot["first_frame"] / 12.5, abs=1e-6)
        assert slot["last_s"] == pytest.approx(slot["last_frame"] / 12.5, abs=1e-6)
        times = files.rows[[slot["first_frame"], slot["last_frame"]], 0]
        np.testing.assert_allclose([slot["first_s"], slot["last_s"]], times, atol=1e-6)
    inner = {wave["frame"] for wave in files.waves}
    wave = next(slot for slot in slots if slot["kind"] == "peristalsis")
    assert inner <= set(range(wave["first_frame"], wave["last_frame"] + 1))
    assert len(inner) >= wave["last_frame"] - wave["first_frame"] - 1


@pytest.mark.parametrize("fps", [12.5, 30.0])
def test_every_frame_of_the_video_is_the_picture_of_its_time(eventful: Path, tmp_path: Path, fps: float) -> None:
    folder = eventful
    if fps != EVENTFUL.motion.fps:
        folder = generate(
            replace(TINY, motion=replace(TINY.motion, frames=7, fps=fps, speed_mm=3.0)), tmp_path, threads=1
        )
    times = np.loadtxt(folder / "trajectory.txt")[:, 0]
    with av.open(str(folder / "video.mp4")) as container:
        decoded = [(float(f.pts * f.time_base), f.to_ndarray(format="rgb24")) for f in container.decode(video=0)]
    np.testing.assert_allclose([time for time, _ in decoded], times, atol=1e-4)
    stored = np.stack([cv2.imread(str(path))[..., ::-1] for path in sorted((folder / "rgb").glob("*.png"))]).astype(
        float
    )
    assert len(decoded) == len(stored)
    for index, (_, image) in enumerate(decoded):
        error = np.sqrt(((stored - image) ** 2).mean(axis=(1, 2, 3)))
        assert error.argmin() == index
        assert error[index] < 8.0
