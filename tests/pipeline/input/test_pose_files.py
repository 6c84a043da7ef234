"""Pose files in the encoding that each program documents, and which frames they belong to."""

import json
import struct
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from pipeline.input.pose_files.pose_table import FilmFrames, PoseTable, first_numbers, poses_by_frame
from pipeline.input.pose_files.registry import lens_beside, read_poses

COUNT = 5
TURNS = Rotation.from_rotvec(np.random.default_rng(0).normal(size=(COUNT, 3)))
CENTRES = np.random.default_rng(1).normal(size=(COUNT, 3))
NAMES = [f"{k:05d}.png" for k in range(COUNT)]
SECONDS = np.arange(COUNT) / 30


def film(names=None, count=COUNT):
    return FilmFrames(np.arange(count), np.arange(count) / 30, names)


def assert_right(table, frames=range(COUNT), names=None):
    found = poses_by_frame(table, film(names), first_numbers(table, film(names))[0])
    assert sorted(found) == list(frames)
    for frame in frames:
        np.testing.assert_allclose(found[frame][:3, :3], TURNS[frame].as_matrix(), atol=1e-6)
        np.testing.assert_allclose(found[frame][:3, 3], CENTRES[frame], atol=1e-6)


def test_tum(tmp_path):
    lines = [
        " ".join(map(str, [t, *c, *q])) for t, c, q in zip(SECONDS, CENTRES, TURNS.as_quat(), strict=True)
    ]  # x y z w
    (tmp_path / "a.txt").write_text("# seconds tx ty tz qx qy qz qw\n" + "\n".join(lines) + "\n")
    assert_right(read_poses(tmp_path / "a.txt"))


def test_kitti(tmp_path):
    rows = [np.column_stack([r, c]).ravel() for r, c in zip(TURNS.as_matrix(), CENTRES, strict=True)]
    np.savetxt(tmp_path / "00.txt", rows)
    assert_right(read_poses(tmp_path / "00.txt"))
    with pytest.raises(HaustraError, match="5 poses without times, and the film 9 frames"):
        poses_by_frame(read_poses(tmp_path / "00.txt"), film(count=9))


def colmap(k):
    """Quaternion w x y z and translation of camera_from_world."""
    turn = TURNS[k].inv()
    x, y, z, w = turn.as_quat()
    return [w, x, y, z, *-turn.apply(CENTRES[k])]


def test_colmap_text_and_binary(tmp_path):
    lines = ["# Image list"]
    for k in (3, 0, 4, 1, 2):  # COLMAP's order is not the names'
        lines += [" ".join(map(str, [k + 1, *colmap(k), 1, NAMES[k]])), "" if k == 4 else "10.5 20.5 -1 3 4 7"]
    (tmp_path / "images.txt").write_text("\n".join(lines) + "\n")
    assert_right(read_poses(tmp_path), names=tuple(NAMES))
    data = struct.pack("<Q", COUNT)
    for k in (3, 0, 4, 1, 2):
        data += struct.pack("<I7dI", k + 1, *colmap(k), 1) + NAMES[k].encode() + b"\0"
        data += struct.pack("<Q", 2) + struct.pack("<ddqddq", 10.5, 20.5, -1, 3, 4, 7)
    (tmp_path / "images.bin").write_bytes(data)
    (tmp_path / "images.txt").unlink()
    (tmp_path / "cameras.bin").touch()
    assert_right(read_poses(tmp_path), names=tuple(NAMES))
    assert_right(read_poses(tmp_path))  # a film's frames have no names, but numbers
    assert lens_beside(tmp_path) == tmp_path / "cameras.bin"
    (tmp_path / "images.bin").write_bytes(data[:-30])
    with pytest.raises(HaustraError, match="cut off"):
        read_poses(tmp_path)


def test_colmap_text_without_lines_of_points_or_with_a_blank_line_first(tmp_path):
    images = [" ".join(map(str, [k + 1, *colmap(k), 1, NAMES[k]])) for k in range(COUNT)]
    (tmp_path / "images.txt").write_text("# Image list\n" + "\n".join(images) + "\n")
    assert_right(read_poses(tmp_path), names=tuple(NAMES))
    points = "10 20 -1 30 40 7 50 60 8 70 80 9"  # as many numbers as an image's line has, and more
    (tmp_path / "images.txt").write_text("# Image list\n\n" + "\n".join(f"{i}\n{points}" for i in images) + "\n")
    assert_right(read_poses(tmp_path), names=tuple(NAMES))


def test_names_that_count_from_one():
    """FFmpeg's first picture is 0001: of a film of five frames the last is 0005."""
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = TURNS.as_matrix(), CENTRES
    assert_right(PoseTable(None, poses, names=tuple(f"{k + 1:04d}.jpg" for k in range(COUNT))))


def test_names_with_the_numbers_of_the_films_own_pictures():
    """Another program has copied img0011, img0013, ... to frame_00011, frame_00013, ... and left some out."""
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = TURNS.as_matrix(), CENTRES
    own = [f"img{11 + 2 * k:04d}.png" for k in range(COUNT)]
    table = PoseTable(None, poses[1:4], names=tuple(f"frame_{11 + 2 * k:05d}.jpg" for k in range(1, 4)))
    assert_right(table, frames=(1, 2, 3), names=tuple(own))


def test_a_model_of_two_cameras_with_pictures_of_the_same_names():
    """COLMAP names pictures by folders, one for each camera: the film is one of them, and never both."""
    poses = np.tile(np.eye(4), (2 * COUNT, 1, 1))
    poses[::2, :3, :3], poses[::2, :3, 3] = TURNS.as_matrix(), CENTRES
    names = tuple(f"{eye}/{name}" for name in NAMES for eye in ("left", "right"))
    table = PoseTable("model", poses, names=names)
    for own in (tuple(NAMES), None):
        frames = FilmFrames(np.arange(COUNT), np.arange(COUNT) / 30, own, ("video", "left"))
        found = poses_by_frame(table, frames)
        np.testing.assert_allclose([found[k] for k in range(COUNT)], poses[::2])
        with pytest.raises(HaustraError, match="the same name in left and right, and the film is called video"):
            poses_by_frame(table, replace(frames, called=("video",)))


def test_a_picture_with_several_poses_is_named():
    table = PoseTable("model", np.tile(np.eye(4), (COUNT, 1, 1)), names=("images/x.png",) * COUNT)
    frames = FilmFrames(np.arange(COUNT), np.arange(COUNT) / 30, None, ("film",))
    with pytest.raises(HaustraError, match=f"model has {COUNT} poses of the picture x: keep one of each picture"):
        poses_by_frame(table, frames)


def test_transforms_json(tmp_path):
    """x right, y up, z backwards: the second and third column are turned."""
    frames = []
    for k in range(COUNT):
        matrix = np.eye(4)
        matrix[:3, :3] = TURNS[k].as_matrix() * [1, -1, -1]
        matrix[:3, 3] = CENTRES[k]
        frames.append({"file_path": f"./images/{NAMES[k]}", "transform_matrix": matrix.tolist()})
    (tmp_path / "transforms.json").write_text(json.dumps({"fl_x": 100, "frames": frames}))
    for path in (tmp_path, tmp_path / "transforms.json"):
        assert_right(read_poses(path), names=tuple(NAMES))
        assert lens_beside(path) == tmp_path / "transforms.json"
    frames[0]["transform_matrix"][0][0] += 1
    (tmp_path / "transforms.json").write_text(json.dumps({"frames": frames}))
    with pytest.raises(HaustraError, match="is no rotation"):
        read_poses(tmp_path)


def test_a_trackers_csv(tmp_path):
    """NDI: Q0 is w. The camera sits on the sensor by a transform that is not the identity."""
    sensor_from_camera = np.eye(4)
    sensor_from_camera[:3, :3] = Rotation.from_euler("xyz", [10, 20, 30], degrees=True).as_matrix()
    sensor_from_camera[:3, 3] = 1, -2, 3
    camera_from_sensor = np.linalg.inv(sensor_from_camera)
    lines = ["Tools,Frame,State,Time,Q0,Qx,Qy,Qz,Tx,Ty,Tz,Error"]
    for k in range(COUNT):
        world_from_camera = np.eye(4)
        world_from_camera[:3, :3], world_from_camera[:3, 3] = TURNS[k].as_matrix(), CENTRES[k]
        world_from_sensor = world_from_camera @ camera_from_sensor
        x, y, z, w = Rotation.from_matrix(world_from_sensor[:3, :3]).as_quat()
        lines.append(",".join(map(str, ["1", k, "OK", SECONDS[k], w, x, y, z, *world_from_sensor[:3, 3], 0.1])))
    lines.insert(3, "1,2,Missing,0.05,,,,,,,,")
    (tmp_path / "ndi.csv").write_text("\n".join(lines) + "\n")
    np.savetxt(tmp_path / "hand_eye.txt", sensor_from_camera)
    assert_right(read_poses(tmp_path / "ndi.csv", tmp_path / "hand_eye.txt"))
    with pytest.raises(HaustraError, match="--hand-eye"):
        read_poses(tmp_path / "ndi.csv")
    (tmp_path / "hand_eye.txt").write_text("1 2 3\n")
    with pytest.raises(HaustraError, match="sixteen numbers"):
        read_poses(tmp_path / "ndi.csv", tmp_path / "hand_eye.txt")


def csv_of(path, order, head, first):
    """A tracker's CSV of the poses in that order; first: text before w x y z and the place of each."""
    lines = [head + ",Q0,Qx,Qy,Qz,Tx,Ty,Tz"]
    for k in order:
        x, y, z, w = TURNS[k].as_quat()
        lines.append(",".join(map(str, [first(k), w, x, y, z, *CENTRES[k]])))
    path.write_text("\n".join(lines) + "\n")
    np.savetxt(path.parent / "hand_eye.txt", np.eye(4))
    return path, path.parent / "hand_eye.txt"


def test_lines_of_a_tracker_that_are_lost_or_in_any_order(tmp_path):
    """Without times the frame's number says which frame a line is of, and without that the line's own place."""
    left = [0, 1, 3, 4]
    for head, first in (
        ("State,Frame", lambda k: f"{'Missing' if k == 2 else 'OK'},{k}"),
        ("State", lambda k: "Missing" if k == 2 else "OK"),
    ):
        assert_right(read_poses(*csv_of(tmp_path / "a.csv", range(COUNT), head, first)), left)
    for lost in ([0], [0, 1], [COUNT - 1]):  # at the start or the end, where no gap tells
        left = [k for k in range(COUNT) if k not in lost]
        path = csv_of(tmp_path / "d.csv", range(COUNT), "State", lambda k, lost=lost: "Missing" if k in lost else "OK")
        assert_right(read_poses(*path), left)
        with pytest.raises(HaustraError, match="one for each frame is needed"):
            poses_by_frame(read_poses(*path), film(count=COUNT + 1))
    for begun, lost in ((3, COUNT - 1), (5000, 0)):  # a tracker that counted before the film began
        left = [k for k in range(COUNT) if k != lost]
        path = csv_of(
            tmp_path / "e.csv",
            range(COUNT),
            "State,Frame",
            lambda k, lost=lost, begun=begun: f"{'Missing' if k == lost else 'OK'},{begun + k}",
        )
        assert_right(read_poses(*path), left)
    blank = csv_of(tmp_path / "f.csv", range(COUNT), "Frame", lambda k: "" if k == 3 else f"{2 * k}")
    with pytest.raises(HaustraError, match="line 5 has no frame number, and others have one"):
        read_poses(*blank)
    none = csv_of(tmp_path / "g.csv", range(COUNT), "State", lambda k: "Missing")
    with pytest.raises(HaustraError, match="all 5 lines are marked as lost"):
        read_poses(*none)
    times = csv_of(tmp_path / "b.csv", [3, 0, 4, 1, 1, 2], "Time", lambda k: SECONDS[k])
    assert_right(read_poses(*times))
    two = csv_of(tmp_path / "c.csv", range(COUNT), "Time", lambda k: SECONDS[k // 2])
    with pytest.raises(HaustraError, match=r"two poses at 0 s, [.\d]+ apart: of two sensors"):
        read_poses(*two)


def test_poses_of_another_film_by_their_times_and_names():
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    with pytest.raises(HaustraError, match=r"only 0 of 5 frames of the film and .* 100 to 104 s.*frame numbers"):
        poses_by_frame(PoseTable("a.txt", poses, 100.0 + np.arange(COUNT)), film())
    with pytest.raises(HaustraError, match="only 0 of the 5 poses"):
        poses_by_frame(PoseTable("a", poses, names=tuple(f"{900 + k}.png" for k in range(COUNT))), film())
    with pytest.raises(HaustraError, match="carry no numbers"):
        poses_by_frame(PoseTable("a", poses, names=tuple("abcde")), film())


@pytest.mark.parametrize("rate", [20, 25, 40, 24])
def test_poses_of_another_rate_than_the_film(rate):
    """Between two poses the camera goes and turns on evenly: that is where it was at a frame's time."""

    def moved(seconds):
        poses = np.tile(np.eye(4), (len(seconds), 1, 1))
        poses[:, :3, :3] = Rotation.from_rotvec(np.outer(seconds, [0.1, 0.9, -0.3])).as_matrix()
        poses[:, :3, 3] = np.outer(seconds, [30, -5, 2])
        return poses

    seconds = np.delete(np.arange(2 * rate) / rate, np.arange(rate, rate + 4))  # and a gap
    found = poses_by_frame(PoseTable("a.txt", moved(seconds), seconds), film(count=60))
    frames = np.array([k for k in found if not seconds[rate - 1] < k / 30 < seconds[rate] and k / 30 < seconds[-1]])
    assert len(frames) > 30
    np.testing.assert_allclose([found[k] for k in frames], moved(frames / 30), atol=1e-9)


def test_what_is_no_pose_file(tmp_path):
    (tmp_path / "a.txt").write_text("1 2 3\n")
    (tmp_path / "b.json").write_text('{"frames": []}')
    (tmp_path / "c.csv").write_text("a,b\n1,2\n")
    for name, message in (
        ("a.txt", "no poses that can be read"),
        ("b.json", "no frames"),
        ("c.csv", "no columns"),
        ("d.txt", "there is no file"),
    ):
        with pytest.raises(HaustraError, match=message):
            read_poses(tmp_path / name)


@pytest.mark.parametrize("turn", ["0 0 0 0", "nan 0 0 0", "inf 0 0 0"])
def test_a_quaternion_of_colmap_that_is_none(tmp_path, turn):
    (tmp_path / "images.txt").write_text(f"1 {turn} 0 0 0 1 0001.png\n\n")
    with pytest.raises(HaustraError, match=r"the quaternion of 0001.png is none"):
        read_poses(tmp_path / "images.txt")


def test_a_number_of_transforms_that_is_too_large(tmp_path):
    matrix = f"[[1{400 * '0'}, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]"
    (tmp_path / "transforms.json").write_text(f'{{"frames": [{{"file_path": "1.png", "transform_matrix": {matrix}}}]}}')
    with pytest.raises(HaustraError, match="transform_matrix of 4x4 numbers"):
        read_poses(tmp_path / "transforms.json")


@pytest.mark.parametrize(
    ("numbers", "first"),
    [((0, 8), (0,)), ((1, 9), (1, 0)), ((1, 10), (1,)), ((1, 8), (1, 0)), ((3, 8), (1, 0)), ((3, 11), (0,))],
)
def test_numbers_that_a_first_frame_can_have(numbers, first):
    """Of ten frames; the last numbers are past the film's end by either count, or leave one count alone."""
    table = PoseTable("a", np.tile(np.eye(4), (2, 1, 1)), names=tuple(f"{k}.png" for k in numbers))
    assert first_numbers(table, film(count=10)) == first
    assert first_numbers(table, film(("a.png",), count=10)) == (0,)


def test_numbers_of_every_tenth_frame_are_those_of_one_count():
    """No frame that was looked at has a number of the other count; the first and the last frame have no pose."""
    tenth = FilmFrames(np.arange(0, 100, 10), np.arange(10) / 3, None)
    for first in (0, 1):
        names = tuple(f"{k + first}.png" for k in range(10, 90, 10))
        table = PoseTable("a", np.tile(np.eye(4), (8, 1, 1)), names=names)
        assert first_numbers(table, tenth) == (first,)
        assert sorted(poses_by_frame(table, tenth, first)) == list(range(10, 90, 10))


def test_numbers_are_those_of_the_films_own_pictures():
    """Another camera's, in a folder beside, count from 0."""
    names = tuple(f"{folder}/{k + first}.png" for folder, first in (("film", 1), ("right", 0)) for k in range(10))
    table = PoseTable("a", np.tile(np.eye(4), (20, 1, 1)), names=names)
    assert first_numbers(table, replace(film(count=10), called=("film",))) == (1,)
