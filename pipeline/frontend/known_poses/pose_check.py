"""Whether given poses are those of the pictures, in which axes, and at the right frames: by epipolar lines.

Each pair of frames has matches. A reading of the poses puts an epipolar plane through each match and says where its
point lies: the second ray must lie in the plane, and the point before both cameras. Wrong axes, inverted poses and
poses of another film put a small part of the matches there.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from haustra.core.errors import HaustraError
from haustra.core.ray_table import RayTable
from haustra.core.se3 import Array
from pipeline.frontend.known_poses.epipolar_lines import FEWEST_MATCHES, MatchedPair, inliers, matched_pairs
from pipeline.frontend.known_poses.time_shift import find_shift
from pipeline.input.pose_files.pose_table import INVERTED, OPENCV, OPENGL
from pipeline.matching.sift import FindFeatures

FITS = 0.5  # share of inliers from which on a reading can be the right one; wrong ones have a tenth
ROUGHLY_FITS = 0.2  # the same of poses that are to be adjusted, as a tracker's, off by a millimetre and a degree
CLEARLY = 0.15  # by which another reading must fit better
Y_UP = np.diag([1.0, -1.0, -1.0, 1.0])
MM_PER_M = 1000.0
MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])


@dataclass(frozen=True)
class PoseCheck:
    """matches: how many were asked. inliers: share that the poses as given explain. depth: median depth of those, in
    the poses' unit."""

    matches: int
    inliers: float
    depth: float


def inverted(world_from_camera: Array) -> Array:
    turned = np.swapaxes(world_from_camera[:, :3, :3], 1, 2)
    result = np.tile(np.eye(4), (len(world_from_camera), 1, 1))
    result[:, :3, :3], result[:, :3, 3] = turned, -np.einsum("nij,nj->ni", turned, world_from_camera[:, :3, 3])
    return result


def scalar_first(world_from_camera: Array) -> Array:
    """As if the file's quaternions had w before x y z."""
    w, x, y, z = Rotation.from_matrix(world_from_camera[:, :3, :3]).as_quat().T
    result = world_from_camera.copy()
    result[:, :3, :3] = Rotation.from_quat(np.stack([x, y, z, w], axis=1)).as_matrix()
    return result


# What the matrices of a file may be, and how each of them becomes world_from_camera in OpenCV's axes. Of what a format
# can ask for, each is its own inverse.
READINGS: dict[str, Callable[[Array], Array]] = {
    OPENCV: lambda p: p,
    INVERTED: inverted,
    OPENGL: lambda p: p @ Y_UP,
    "camera_from_world in OpenGL's axes": lambda p: inverted(p) @ Y_UP,
    "world_from_camera of a left-handed world (y down in the camera, up in the file)": lambda p: MIRROR @ p @ MIRROR,
    "world_from_camera with w before x y z in its quaternions": scalar_first,
}


def readings_of_hand_eye(sensor_from_camera: Array) -> dict[str, Callable[[Array], Array]]:
    """What the poses of a tracker's sensor would be by another reading of the transform (4,4)."""
    camera_from_sensor = np.linalg.inv(sensor_from_camera)
    longer, shorter = sensor_from_camera.copy(), sensor_from_camera.copy()
    longer[:3, 3] *= MM_PER_M
    shorter[:3, 3] /= MM_PER_M
    return {
        "those of a hand-eye transform that is inverted, camera_from_sensor": (
            lambda p: p @ camera_from_sensor @ camera_from_sensor
        ),
        "those of a hand-eye transform in m beside a tracker's in mm": lambda p: p @ camera_from_sensor @ longer,
        "those of a hand-eye transform in mm beside a tracker's in m": lambda p: p @ camera_from_sensor @ shorter,
    }


def check_poses(
    path: Path,
    frames: Sequence[int],
    world_from_camera: Array,
    rays: RayTable,
    find: FindFeatures,
    fits: float = FITS,
    sensor_from_camera: Array | None = None,
    seconds_apart: float | None = None,
    written: str = OPENCV,
) -> PoseCheck:
    """Test world_from_camera (N,4,4) of frames. HaustraError, one sentence, where another reading of the file fits the
    pictures, the poses are those of other frames, or no reading fits.

    fits: the share of inliers that is asked for. sensor_from_camera (4,4): of a tracker. seconds_apart: between two
    frames, where the poses have times. written: what the file's format asks for, which the poses were read as.
    """
    pairs = matched_pairs(frames, rays, find)
    asked = sum(len(pair.first) for pair in pairs)
    if asked < FEWEST_MATCHES:
        raise HaustraError(
            f"the poses of {path} cannot be tested: no two of {len(frames)} posed frames show the same from places "
            "apart"
        )
    readings = READINGS | ({} if sensor_from_camera is None else readings_of_hand_eye(sensor_from_camera))
    in_file = READINGS[written](world_from_camera)
    share = {name: _inlier_share(pairs, read(in_file), rays.focal_px) for name, read in readings.items()}
    given, best = share[written], max(share, key=lambda name: share[name])
    counted = f"{100 * share[best]:.0f} % of {asked} matches lie on their epipolar lines"
    if share[best] >= fits and share[best] > given + CLEARLY:
        raise HaustraError(
            f"the poses of {path} fit the pictures as {best}: so read, {counted}, and as {written}"
            f"{'' if written == OPENCV else ', as this format has them,'} {100 * given:.0f} %; convert them"
        )
    shift = find_shift(frames, world_from_camera, pairs, rays.focal_px)
    if shift is not None:
        raise HaustraError(shift.sentence(path, seconds_apart))
    if given < fits:
        other = "" if sensor_from_camera is None else ", the hand-eye transform another one (--hand-eye)"
        raise HaustraError(
            f"the poses of {path} are not those of these pictures: read in any axes, at most {counted}; are they of "
            f"another film, shifted in time{other}, or is the lens another one (--camera)?"
        )
    return PoseCheck(asked, given, _median_depth(pairs, world_from_camera, rays.focal_px))


def _inlier_share(pairs: list[MatchedPair], world_from_camera: Array, focal_px: float) -> float:
    good = np.concatenate([inliers(pair, world_from_camera, focal_px)[0] for pair in pairs])
    return float(good.mean())


def _median_depth(pairs: list[MatchedPair], world_from_camera: Array, focal_px: float) -> float:
    found = [inliers(pair, world_from_camera, focal_px) for pair in pairs]
    return float(np.median(np.concatenate([depth[good] for good, depth in found])))
