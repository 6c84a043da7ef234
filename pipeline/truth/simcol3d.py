"""SimCol3D: `Frames_S1/` with `SavedPosition_S1.txt` (cm) and `SavedRotationQuaternion_S1.txt` (x y z w) beside it.

Unity's world is left-handed: a pose P becomes T P T with T = diag(1, -1, 1, 1), which also turns the camera's y down.
"""

from pathlib import Path

import numpy as np

from completion.data.readers import read_evaluation_frames
from haustra.core.errors import HaustraError
from pipeline.input.camera_presets import PRESETS
from pipeline.truth.data_set_truth import Array, DataSetTruth, rotations_of, table_of

MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])
MM_PER_CM = 10.0


def read_simcol3d(folder: Path) -> DataSetTruth | None:
    name = folder.name.removeprefix("Frames_")
    place, turn = (folder.parent / f"Saved{what}_{name}.txt" for what in ("Position", "RotationQuaternion"))
    if not place.is_file() or not turn.is_file():
        return None
    places, turns = table_of(place, 3), table_of(turn, 4)
    if len(places) != len(turns):
        raise HaustraError(f"{place} has {len(places)} places and {turn.name} {len(turns)} rotations")
    has_depth = next(folder.glob("Depth_*.png"), None) is not None
    depths = (frame.depth for frame in read_evaluation_frames(folder, "simcol3d")) if has_depth else ()
    camera = PRESETS["simcol3d"].camera if has_depth else None
    rotations = rotations_of(turn, turns)
    return DataSetTruth(right_handed(MM_PER_CM * places, rotations), depths=depths, camera=camera)


def right_handed(places: Array, rotations: Array) -> Array:
    """world_from_camera (N,4,4), OpenCV's axes, of Unity's places (N,3) and rotations (N,3,3)."""
    world_from_camera = np.tile(np.eye(4), (len(places), 1, 1))
    world_from_camera[:, :3, :3] = rotations
    world_from_camera[:, :3, 3] = places
    return np.asarray(MIRROR @ world_from_camera @ MIRROR)
