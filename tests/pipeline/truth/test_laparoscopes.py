"""Truth of stereo laparoscopes, encoded by this test as the sets document it."""

import io
import json
import tarfile

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline.truth.registry import read_data_set_truth
from tests.helpers.videos import tiff_of_floats

COUNT, WIDTH, HEIGHT = 4, 80, 64
K = [[66.0, 0, 39.0], [0, 66.0, 31.5], [0, 0, 1]]
WALL_MM = 60.0  # z of a wavy wall in the world
RNG = np.random.default_rng(5)


def poses():
    found = np.tile(np.eye(4), (COUNT, 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(RNG.normal(0, 0.1, (COUNT, 3))).as_matrix()
    found[:, :3, 3] = np.cumsum(RNG.normal([6, 4, 2], 1, (COUNT, 3)), axis=0)
    return found


def points_seen(world_from_camera):
    """(2H,W,3): the left eye's points of the wall above something that is not to be read."""
    x, y = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(x - K[0][2]) / K[0][0], (y - K[1][2]) / K[1][1], np.ones_like(x)], axis=-1)
    depth = np.full(x.shape, WALL_MM)
    for _ in range(30):
        world = rays * depth[..., None] @ world_from_camera[:3, :3].T + world_from_camera[:3, 3]
        depth *= (WALL_MM + 6 * np.sin(world[..., 0] / 5) * np.cos(world[..., 1] / 4) - world_from_camera[2, 3]) / (
            world[..., 2] - world_from_camera[2, 3]
        )
    points = rays * depth[..., None]
    points[:3] = 0  # none there
    return np.concatenate([points, np.full_like(points, 7.0)])


def frame_data(matrix):
    lens = {"KL": K, "DL": [[0.0, 0.0, 0.0, 0.0, 0.0]], "KR": K, "DR": [[0.0] * 5], "R": np.eye(3).tolist()}
    return json.dumps({"camera-pose": matrix.tolist(), "camera-calibration": lens, "timestamp": 0})


def write_scared(keyframe, stored, truth, count=COUNT):
    (keyframe / "data/frame_data").mkdir(parents=True)
    (keyframe / "data/scene_points").mkdir()
    for k, world_from_camera in enumerate(stored):
        (keyframe / f"data/frame_data/frame_data{k:06d}.json").write_text(frame_data(world_from_camera))
    for k, world_from_camera in enumerate(truth[:count]):
        (keyframe / f"data/scene_points/scene_points{k:06d}.tiff").write_bytes(
            tiff_of_floats(points_seen(world_from_camera))
        )


@pytest.mark.parametrize("direction", [1, -1], ids=["world_from_camera", "camera_from_world"])
def test_scared_s_points_tell_which_way_its_poses_go(tmp_path, direction):
    truth = poses()
    stored = truth if direction == 1 else np.linalg.inv(truth)
    write_scared(tmp_path / "keyframe_1", stored, truth)
    found = read_data_set_truth(tmp_path / "keyframe_1")
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-5)
    seen = found.surface().seen
    assert len(seen) > 1000
    wall = WALL_MM + 6 * np.sin(seen[:, 0] / 5) * np.cos(seen[:, 1] / 4)
    assert np.percentile(np.abs(seen[:, 2] - wall), 90) < 0.8  # the surface is thinned to voxels' means


def test_scared_without_points_and_in_its_archive(tmp_path):
    truth = poses()
    (tmp_path / "data").mkdir()
    with tarfile.open(tmp_path / "data/frame_data.tar.gz", "w:gz") as archive:
        for k, camera_from_world in reversed(list(enumerate(np.linalg.inv(truth)))):
            text = frame_data(camera_from_world).encode()
            member = tarfile.TarInfo(f"frame_data{k:06d}.json")
            member.size = len(text)
            archive.addfile(member, io.BytesIO(text))
    found = read_data_set_truth(tmp_path)
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-6)
    assert found.surface() is None
    whole = (tmp_path / "data/frame_data.tar.gz").read_bytes()
    (tmp_path / "data/frame_data.tar.gz").write_bytes(whole[: len(whole) // 2])
    with pytest.raises(HaustraError, match="cannot be read to its end"):
        read_data_set_truth(tmp_path)


def test_what_scared_must_have(tmp_path):
    write_scared(tmp_path, poses(), poses(), count=0)
    (tmp_path / "data/frame_data/frame_data000001.json").unlink()
    with pytest.raises(HaustraError, match="without a gap"):
        read_data_set_truth(tmp_path)
    (tmp_path / "data/frame_data/frame_data000001.json").write_text('{"camera-pose": [[1, 0], [0, 1]]}')
    with pytest.raises(HaustraError, match="lacks camera-pose"):
        read_data_set_truth(tmp_path)


def test_stereomis_is_in_metres(tmp_path):
    truth = poses()
    quaternions = Rotation.from_matrix(truth[:, :3, :3]).as_quat()
    rows = np.column_stack([1.6e9 + np.arange(COUNT), truth[:, :3, 3] / 1000, quaternions])
    lines = [", ".join(f"{value:.12g}" for value in row) for row in rows]
    (tmp_path / "groundtruth.txt").write_text("\n".join(["# time tx ty tz qx qy qz qw", *lines, ""]))
    assert read_data_set_truth(tmp_path) is None  # a TUM file alone says nothing of its unit
    (tmp_path / "StereoCalibration.ini").write_text("[StereoLeft]\n")
    found = read_data_set_truth(tmp_path)
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-6)
    assert found.seconds is None  # a line for each frame
    (tmp_path / "groundtruth.txt").write_text("1 2 3\n")
    with pytest.raises(HaustraError, match="eight finite numbers"):
        read_data_set_truth(tmp_path)


def test_hamlyn_has_no_path(tmp_path):
    (tmp_path / "image01").mkdir()
    (tmp_path / "depth01").mkdir()
    (tmp_path / "intrinsics.txt").write_text("383.19 0 155.97\n0 383.19 124.33\n0 0 1\n")
    with pytest.raises(HaustraError, match="no camera path"):
        read_data_set_truth(tmp_path)
