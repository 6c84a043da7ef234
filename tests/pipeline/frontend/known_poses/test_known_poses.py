"""Poses that are given for the views of a tube: its wall is where the poses put it, and wrong ones are named."""

import json
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.progress import SilentProgress
from haustra.core.ray_table import RayTable
from pipeline.config import Config, PoseSettings
from pipeline.frontend.known_poses.pose_check import READINGS, check_poses
from pipeline.frontend.odometry.frame_io import frame_features
from pipeline.frontend.points_stage import find_points
from pipeline.frontend.registry import check_front_end
from pipeline.frontend.structure_stage import scene_unit, solve_structure
from pipeline.input.pose_files.pose_table import INVERTED, OPENCV, OPENGL
from pipeline.surface.given_scales import scale_of_poses
from reconstruction.evaluation.trajectory_io import write_tum
from tests.helpers.tubes.textured_tube import RADIUS, camera_at, render, stored

COUNT = 24
POSES = np.stack([camera_at(k) for k in range(COUNT)])
Y_UP = np.diag([1.0, -1, -1, 1])
MIRROR = np.diag([1.0, -1, 1, 1])


@pytest.fixture(scope="module")
def pictures():
    return [render(world_from_camera) for world_from_camera in POSES]


def filmed(tmp_path, pictures, poses, refine=False, **settings):
    """Workspace and frames of the pictures, with a file of their poses."""
    workspace, frames = stored(tmp_path, pictures)
    listed = [[k, k / 30, "used"] for k in range(len(poses))]
    workspace.frames.write_text(json.dumps({"camera": frames.camera.to_dict(), "frames": listed}))
    workspace.record["source"] = {"path": "film.mp4"}
    write_tum(tmp_path / "poses.txt", np.arange(len(poses)) / 30, poses)
    config = Config(poses=PoseSettings(file=str(tmp_path / "poses.txt"), refine=refine), **settings)
    workspace.record["config"] = config.model_dump(mode="json")
    check_front_end(config.front_end, config.front_end_settings)
    return workspace, frames


def solve(workspace, frames):
    settings = workspace.config.front_end_settings
    return solve_structure(frames, frame_features(workspace), "auto", settings, workspace, SilentProgress())


def solved(tmp_path, pictures, poses, refine=False):
    workspace, frames = filmed(tmp_path, pictures, poses, refine)
    found = solve(workspace, frames)
    (submap,) = find_points(frames, frame_features(workspace), found, 0.012, workspace, SilentProgress())
    unit = scene_unit(workspace)
    return submap.scaled(unit), unit


@pytest.fixture(scope="module")
def given(tmp_path_factory, pictures):
    """The submap by the true poses, in their unit, and how many of it a scene unit is."""
    return solved(tmp_path_factory.mktemp("given"), pictures, POSES)


def radius_error(submap):
    """Of the points from the wall, median share of its radius; those at the far end, past the tube's texture, too."""
    return np.median(np.abs(np.hypot(*submap.points[:, :2].T) / RADIUS - 1))


def test_the_wall_is_where_the_poses_put_it(given):
    submap, unit = given
    np.testing.assert_array_equal(submap.frames, np.arange(COUNT))
    np.testing.assert_allclose(submap.world_from_camera, POSES, atol=1e-6)  # they stay
    assert len(submap.points) > 400
    assert radius_error(submap) < 0.01
    assert np.median(submap.error_px) < 0.4
    assert scale_of_poses(unit, 1.0).factor == unit
    assert (scale_of_poses(unit, 1.0).unit, scale_of_poses(unit, None).unit) == ("mm", "scene")


def test_a_unit_of_poses_that_no_endoscope_can_see_from_is_one_sentence(tmp_path, pictures):
    """Metres called mm, and the other way: the tube is 20 wide or so, in the unit of its poses."""
    workspace, frames = filmed(tmp_path, pictures, POSES)
    for mm_per_unit in (0.01, 1000.0):
        settings = PoseSettings(file=str(tmp_path / "poses.txt"), mm_per_unit=mm_per_unit)
        workspace.record["config"] = Config(poses=settings).model_dump(mode="json")
        with pytest.raises(HaustraError, match=r"by the poses the wall is .* mm away.*poses' unit \(--poses-mm\)"):
            solve(workspace, frames)


def test_a_unit_of_poses_that_few_see_from_is_doubted(given):
    submap, _ = given
    median = np.median(submap.depths()[submap.depths() > 0])
    assert not scale_of_poses(1.0, 30 / median, submap).doubt
    for away in (5, 150):
        assert "check" in scale_of_poses(1.0, away / median, submap).doubt


@pytest.mark.slow
def test_a_slow_film_has_points_in_all_its_keyframes(tmp_path):
    """Keyframes are many frames apart, and the others see nothing."""
    poses = np.stack([camera_at(0.12 * k) for k in range(80)])
    workspace, frames = filmed(tmp_path, [render(world_from_camera) for world_from_camera in poses], poses)
    (before,) = solve(workspace, frames)
    (after,) = find_points(frames, frame_features(workspace), [before], 0.012, workspace, SilentProgress())
    keyframes = np.unique(before.observations[:, 0])
    assert 3 < len(keyframes) < 40
    np.testing.assert_array_equal(np.unique(after.observations[:, 0]), keyframes)
    assert after.track_lengths().mean() > before.track_lengths().mean()  # matched beyond the next four
    assert len(after.points) != len(before.points)


def test_rough_poses_are_refined_in_their_own_world_and_unit(tmp_path, pictures):
    rng = np.random.default_rng(0)
    rough = POSES.copy()
    rough[:, :3, 3] += rng.normal(0, 0.15, (COUNT, 3))
    rough[:, :3, :3] = Rotation.from_rotvec(np.radians(rng.normal(0, 0.3, (COUNT, 3)))).as_matrix() @ rough[:, :3, :3]
    submap, _ = solved(tmp_path, pictures, rough, refine=True)

    def off(poses):
        return np.sqrt(((poses[:, :3, 3] - POSES[:, :3, 3]) ** 2).sum(axis=1).mean())

    assert off(submap.world_from_camera) < 0.5 * off(rough)
    assert radius_error(submap) < 0.01  # the unit has not slid away


def turning(poses, first=0):
    turned = poses.copy()
    turns = Rotation.from_euler("y", 15 * np.sin(0.3 * (first + np.arange(COUNT)))[:, None], degrees=True)
    turned[:, :3, :3] = poses[:, :3, :3] @ turns.as_matrix()
    return turned


@pytest.mark.parametrize(("longer", "doubted"), [(1.0, False), (0.92, True)])
def test_a_lens_of_another_endoscope_is_doubted_at_given_poses(tmp_path, longer, doubted):
    def with_another_lens(frames):
        focal, *others = frames.camera.params
        return replace(frames, camera=replace(frames.camera, params=(longer * focal, *others)))

    poses = turning(POSES)  # which is what tells a focal length
    workspace, frames = filmed(tmp_path, [render(one) for one in poses], poses, camera="lens.yaml")
    solve(workspace, with_another_lens(frames))
    said = [sentence for sentence in workspace.result("structure")["warnings"] if "another endoscope" in sentence]
    assert len(said) == doubted
    assert all("the lens that these poses were found with" in sentence for sentence in said)


def inverted(poses):
    return np.linalg.inv(poses)


def scalar_first(poses):
    """The file has w x y z where x y z w is read."""
    wrong = poses.copy()
    quaternions = Rotation.from_matrix(poses[:, :3, :3]).as_quat()[:, [3, 0, 1, 2]]
    wrong[:, :3, :3] = Rotation.from_quat(quaternions).as_matrix()
    return wrong


WRONG = {
    "camera_from_world in OpenCV's axes": inverted(POSES),
    "OpenGL's axes": POSES @ Y_UP,
    "camera_from_world in OpenGL's axes": inverted(POSES @ Y_UP),
    "left-handed world": MIRROR @ POSES @ MIRROR,
    "w before x y z": scalar_first(POSES),
}


@pytest.mark.parametrize("name", WRONG)
def test_wrong_axes_are_named_in_one_sentence(tmp_path, pictures, name):
    with pytest.raises(HaustraError, match=r"fit the pictures as .*convert them") as refusal:
        solved(tmp_path, pictures, WRONG[name])
    assert name in str(refusal.value)
    assert "poses.txt" in str(refusal.value)


@pytest.mark.parametrize("written", [INVERTED, OPENGL])
def test_axes_are_told_as_they_are_in_the_file(tmp_path, pictures, written):
    """A file in OpenCV's axes whose format asks for others, which the reader took it for."""
    workspace, frames = filmed(tmp_path, pictures, POSES)
    misread, features, rays = READINGS[written](POSES), frame_features(workspace), RayTable(frames.camera)
    with pytest.raises(HaustraError) as refusal:
        check_poses(tmp_path / "poses", range(COUNT), misread, rays, features, written=written)
    assert f"fit the pictures as {OPENCV}: so read" in str(refusal.value)
    assert f"and as {written}, as this format has them, " in str(refusal.value)


SENSOR_FROM_CAMERA = np.eye(4)
SENSOR_FROM_CAMERA[:3, :3] = Rotation.from_euler("xyz", [40, -2, 3], degrees=True).as_matrix()
SENSOR_FROM_CAMERA[:3, 3] = 2, -1, 9
IN_M, IN_MM = np.diag([1e-3, 1e-3, 1e-3, 1]), np.diag([1e3, 1e3, 1e3, 1])


@pytest.mark.parametrize(
    ("unit", "hand_eye", "told"),
    [
        (1, np.linalg.inv(SENSOR_FROM_CAMERA), "hand-eye transform that is inverted"),
        (1e-3, SENSOR_FROM_CAMERA, "hand-eye transform in mm beside a tracker's in m"),
        (1, IN_M @ SENSOR_FROM_CAMERA @ IN_MM, "hand-eye transform in m beside a tracker's in mm"),
    ],
)
def test_a_wrong_hand_eye_transform_is_named(tmp_path, unit, hand_eye, told):
    """The camera turns, which is what tells how far it is from the sensor."""
    poses = turning(POSES)
    workspace, frames = filmed(tmp_path, [render(one) for one in poses], poses)
    sensor = poses @ np.linalg.inv(SENSOR_FROM_CAMERA)
    turns = Rotation.from_matrix(sensor[:, :3, :3]).as_quat()
    table = np.column_stack([np.arange(COUNT) / 30, unit * sensor[:, :3, 3], turns])
    np.savetxt(tmp_path / "em.csv", table, delimiter=",", header="Time,Tx,Ty,Tz,Qx,Qy,Qz,Qw", comments="")
    np.savetxt(tmp_path / "hand_eye.txt", hand_eye)
    given = PoseSettings(file=str(tmp_path / "em.csv"), hand_eye=str(tmp_path / "hand_eye.txt"))
    workspace.record["config"] = Config(poses=given).model_dump(mode="json")
    with pytest.raises(HaustraError, match=f"{told}.*: so read, .*convert them"):
        solve(workspace, frames)


@pytest.mark.parametrize("how", ["shuffled", "of another path"])
def test_poses_of_another_film_are_refused(tmp_path, pictures, how):
    poses = POSES[np.random.default_rng(1).permutation(COUNT)]
    if how == "of another path":
        poses = np.stack([camera_at(7 * k + 400, step=0.3) for k in range(COUNT)])
    with pytest.raises(HaustraError, match="not those of these pictures"):
        solved(tmp_path, pictures, poses)


@pytest.mark.parametrize(
    ("late", "told"),
    [(1, r"1 frame late.*take 0\.033 s from each pose's time"), (-2, r"2 frames early.*add 0\.067 s to each pose's")],
)
def test_poses_of_other_frames_are_named_with_their_shift(tmp_path, late, told):
    poses = turning(np.stack([camera_at(k - late) for k in range(COUNT)]), -late)
    with pytest.raises(HaustraError, match=told):
        solved(tmp_path, [render(one) for one in turning(POSES)], poses)


@pytest.mark.parametrize("first", [0, 1])
def test_the_pictures_tell_whether_names_count_from_0_or_1(tmp_path, pictures, first):
    """Neither the first nor the last frame has a pose, as of a film whose ends COLMAP could not register."""
    workspace, frames = filmed(tmp_path, pictures, POSES)
    posed = range(2, COUNT - 2)
    listed = [{"file_path": f"f_{k + first:04d}.png", "transform_matrix": (POSES[k] @ Y_UP).tolist()} for k in posed]
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": listed}))
    settings = PoseSettings(file=str(tmp_path / "transforms.json"))
    workspace.record["config"] = Config(poses=settings).model_dump(mode="json")
    (submap,) = solve(workspace, frames)
    np.testing.assert_array_equal(submap.frames, list(posed))


def test_settings_that_contradict_each_other():
    poses = PoseSettings(file="a.txt")
    with pytest.raises(HaustraError, match="takes the place of the front end sfm"):
        check_front_end("sfm", Config(poses=poses).front_end_settings)
    with pytest.raises(HaustraError, match="needs a file of poses"):
        check_front_end("poses", Config().front_end_settings)
    with pytest.raises(ValueError, match="needs a file of them"):
        PoseSettings(refine=True)
