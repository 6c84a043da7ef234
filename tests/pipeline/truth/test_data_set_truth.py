"""Truth on disk as each data set writes it: a plane seen from known poses, encoded by this test, comes out as one."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from completion.data import readers
from haustra.core.errors import HaustraError
from pipeline.input.camera_presets import PRESETS
from pipeline.input.frames import Frames
from pipeline.truth.registry import read_data_set_truth

COUNT = 4
RNG = np.random.default_rng(0)
PLANE_MM = 40.0  # z of the wall in the world


def poses():
    """world_from_camera looking along z, with some turn and way, mm."""
    found = np.tile(np.eye(4), (COUNT, 1, 1))
    found[:, :3, :3] = Rotation.from_rotvec(RNG.normal(0, 0.15, (COUNT, 3))).as_matrix()
    found[:, :3, 3] = RNG.normal(0, 4, (COUNT, 3))
    return found


def depth_of_plane(rays, world_from_camera):
    """z-depth (N,) at which rays (N,3), z = 1, of a camera meet the plane."""
    return (PLANE_MM - world_from_camera[2, 3]) / (rays @ world_from_camera[:3, :3].T)[:, 2]


def c3vd_rays(width, height):
    """The data set's own definition (python/exampleDataLoader.py of DurrLab/C3VD), at a fifth of its size."""
    a0, a2, a3, a4 = 769.243600037458, -0.000812770624150226, 6.25674244578925e-07, -1.19662182144280e-09
    x, y = np.meshgrid(5 * (np.arange(width) + 0.5) - 0.5, 5 * (np.arange(height) + 0.5) - 0.5)
    offset = np.stack([x.ravel() - 678.544839263292, y.ravel() - 542.975887548343])
    stretch = [[0.999986882249990, 0.00288273829525059], [-0.00296316513429569, 1]]
    u, v = np.linalg.solve(stretch, offset)
    rho = np.hypot(u, v)
    z = a0 + a2 * rho**2 + a3 * rho**3 + a4 * rho**4
    return np.column_stack([u / z, v / z, np.ones(len(z))]), z > 300


def write_c3vd(folder, truth):
    folder.mkdir()
    # The renderer writes columns: reading rows gives the transpose, with the translation in the last row.
    lines = [",".join(f"{value:.9g}" for value in world_from_camera.ravel(order="F")) for world_from_camera in truth]
    (folder / "pose.txt").write_text("\n".join(lines) + "\n")
    rays, ahead = c3vd_rays(270, 216)
    for k, world_from_camera in enumerate(truth):
        depth = np.where(ahead, depth_of_plane(rays, world_from_camera), 0)
        raw = np.clip(np.rint(depth * 65535 / 100), 0, 65535).astype(np.uint16).reshape(216, 270)
        cv2.imwrite(str(folder / f"{k:04d}_depth.tiff"), raw)
        cv2.imwrite(str(folder / f"{k:04d}_color.png"), np.zeros((216, 270, 3), np.uint8))


def test_c3vd_s_matrices_are_transposed(tmp_path):
    truth = poses()
    write_c3vd(tmp_path / "cecum_t1_a", truth)
    found = read_data_set_truth(tmp_path / "cecum_t1_a")
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-6)
    assert found.seconds is None
    surface = found.surface()
    assert len(surface.seen) > 1000
    assert np.percentile(np.abs(surface.seen[:, 2] - PLANE_MM), 95) < 0.02  # 1.5 um a step; the lens must fit, too


@pytest.mark.parametrize("more", ["poses", "depth images"])
def test_a_part_of_a_data_set_is_not_paired_by_order(tmp_path, more):
    folder, truth = tmp_path / "cecum_t1_a", poses()
    write_c3vd(folder, truth)
    if more == "poses":
        for path in folder.glob(f"{1:04d}_*"):
            path.unlink()
    else:
        lines = (folder / "pose.txt").read_text().splitlines()
        (folder / "pose.txt").write_text("\n".join(lines[:-1]) + "\n")
    with pytest.raises(HaustraError, match=f"and more {more}, so that they cannot be paired"):
        read_data_set_truth(folder).surface()


def test_c3vd_poses_that_somebody_has_transposed_already(tmp_path):
    truth = poses()
    (tmp_path / "pose.txt").write_text(
        "\n".join(",".join(map(str, world_from_camera.ravel())) for world_from_camera in truth)
    )
    with pytest.raises(HaustraError, match="last column"):
        read_data_set_truth(tmp_path)


def write_unity(path, truth, mm_per_unit):
    """Places and quaternions (x y z w) of the left-handed world with y up that Unity would store for these poses."""
    mirror = np.diag([1.0, -1.0, 1.0])
    places = truth[:, :3, 3] @ mirror / mm_per_unit
    turns = Rotation.from_matrix(mirror @ truth[:, :3, :3] @ mirror).as_quat()
    return places, turns


def test_simcol3d_is_left_handed_and_in_centimetres(tmp_path):
    truth, folder = poses(), tmp_path / "SyntheticColon_I" / "Frames_S1"
    folder.mkdir(parents=True)
    places, turns = write_unity(folder, truth, 10.0)
    np.savetxt(folder.parent / "SavedPosition_S1.txt", places)
    np.savetxt(folder.parent / "SavedRotationQuaternion_S1.txt", turns)
    x, y = np.meshgrid(np.arange(475) + 0.5, np.arange(475) + 0.5)
    rays = np.column_stack([(x.ravel() - 237.5) / 227.60416, (y.ravel() - 237.5) / 227.60416, np.ones(x.size)])
    for k, world_from_camera in enumerate(truth):
        depth = np.clip(depth_of_plane(rays, world_from_camera), 0, 195).reshape(475, 475)
        cv2.imwrite(str(folder / f"Depth_{k:04d}.png"), np.rint(depth / 200 * 256 * 255).astype(np.uint16))
        cv2.imwrite(str(folder / f"FrameBuffer_{k:04d}.png"), np.zeros((475, 475, 3), np.uint8))
    found = read_data_set_truth(folder)
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-6)
    surface = found.surface()
    assert np.percentile(np.abs(surface.required[:, 2] - PLANE_MM), 95) < 0.02
    np.savetxt(folder.parent / "SavedRotationQuaternion_S1.txt", 0 * turns)
    with pytest.raises(HaustraError, match="quaternion of length 0 as pose 1"):
        read_data_set_truth(folder)
    (folder.parent / "SavedPosition_S1.txt").write_text("1 2\n")
    with pytest.raises(HaustraError, match="3 finite numbers"):
        read_data_set_truth(folder)


def test_endomapper_simulated(tmp_path):
    truth = poses()
    places, turns = write_unity(tmp_path, truth, 100.0)
    lines = ["tX;tY;tZ;rX;rY;rZ;rW;time"]
    lines += [";".join(map(str, [*p, *q, 5 + k / 25])) for k, (p, q) in enumerate(zip(places, turns, strict=True))]
    (tmp_path / "trajectory.csv").write_text("\n".join(lines) + "\n")
    found = read_data_set_truth(tmp_path)
    np.testing.assert_allclose(found.world_from_camera, truth, atol=1e-6)
    np.testing.assert_allclose(found.seconds, np.arange(COUNT) / 25)
    assert found.surface() is None


def test_another_folder_has_none(tmp_path):
    assert read_data_set_truth(tmp_path) is None


def test_times_of_frames_that_were_left_out():
    """A pose for each frame is paired by number: frames 2, 3 and 6 of ten at 25 a second were worked with."""
    index = np.array([2, 3, 6])
    frames = Frames(index, index / 25, PRESETS["simcol3d"].camera, np.zeros((1, 1), np.uint8), {})
    np.testing.assert_allclose(frames.seconds_of_numbers(np.arange(10)), np.arange(10) / 25, atol=1e-12)


def test_readers_and_presets_have_one_lens():
    for lens, preset in ((readers.SIMCOL_LENS, "simcol3d"), (readers.VRCAPS_LENS, "endomapper-sim")):
        assert lens == PRESETS[preset].camera.params
    assert PRESETS["endoslam-unitycam"].camera.params[:4] == readers.UNITYCAM_LENS
    assert PRESETS["csd"].camera.params == readers.CSD_LENS


def test_c3vd_s_coverage_mesh_says_which_wall_was_seen(tmp_path):
    truth = poses()
    write_c3vd(tmp_path / "cecum_t1_a", truth)
    corners = ["v 0 0 40", "v 10 0 40", "v 10 10 40", "v 0 10 40", "vt 0.25 0.5", "vt 0.75 0.5"]
    path = tmp_path / "cecum_t1_a" / "coverage_mesh.obj"
    path.write_text("\n".join([*corners, "f 1/1 2/1 3/1", "f 1/2/1 3/2/1 4/2/1"]) + "\n")
    wall = read_data_set_truth(tmp_path / "cecum_t1_a").wall
    assert wall.seen.tolist() == [True, False]
    np.testing.assert_allclose(wall.mesh.face_areas, [50, 50])
    path.write_text("\n".join([*corners, "f 1 2 3"]))
    with pytest.raises(HaustraError, match="v/vt are expected"):
        read_data_set_truth(tmp_path / "cecum_t1_a")
    for line, said in (("f 1/1 2/1 9/1", "4 vertices, and faces of others"), ("f 1/1 2/1 x/1", "not of numbers")):
        path.write_text("\n".join([*corners, line]))
        with pytest.raises(HaustraError, match=said):
            read_data_set_truth(tmp_path / "cecum_t1_a")
    path.write_text("\n".join([*corners, "f 1/1 2/2 3/3"]))
    with pytest.raises(HaustraError, match="not 1"):
        read_data_set_truth(tmp_path / "cecum_t1_a")
