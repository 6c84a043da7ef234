"""A phantom's film once more as a stereo endoscope would have taken it: side-by-side pictures, and the calibration.

python scripts/stereo_film.py FILM OUT --baseline 4

FILM is a folder of `haustra phantom`. OUT/rgb holds its frames with those of a second eye, BASELINE mm to the right,
beside them, under the direct light of the same lamps; OUT/rig.yaml is the calibration in OpenCV's form. The truth stays
in FILM. Then:

reconstruct OUT --stereo OUT/rig.yaml; haustra compare RUN FILM
"""

import argparse
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import yaml
from numpy.typing import NDArray

from haustra.core.camera import read_camera
from haustra.phantom.config import PhantomConfig
from haustra.phantom.dataset.script import write_script
from haustra.phantom.imaging.render import Phantom


def write_rig(path: Path, matrix: NDArray[np.float64], size: tuple[int, int], baseline: float) -> None:
    """matrix: K in COLMAP's pixels."""
    k = matrix.copy()
    k[:2, 2] -= 0.5
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", size[0])
    storage.write("image_height", size[1])
    for name, values in (("M1", k), ("D1", np.zeros((1, 5))), ("M2", k), ("D2", np.zeros((1, 5)))):
        storage.write(name, values)
    storage.write("R", np.eye(3))
    storage.write("T", np.array([[-baseline], [0.0], [0.0]]))
    storage.release()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("film", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--baseline", type=float, default=4.0, help="mm")
    wanted = parser.parse_args()
    camera = read_camera(wanted.film / "camera.json")
    if not camera.is_pinhole:
        raise SystemExit(f"{wanted.film} is no film of a pinhole")
    config = PhantomConfig.from_dict(yaml.safe_load((wanted.film / "config.yaml").read_text()))
    phantom = Phantom(config, 1)
    script = write_script(phantom)
    lit_from_the_left = replace(config.imaging, light_shift_mm=config.imaging.light_shift_mm - wanted.baseline)
    second_eye = np.eye(4)
    second_eye[0, 3] = wanted.baseline
    film = phantom.seen_through(lit_from_the_left, config.camera).film(
        script.world_from_camera @ second_eye, script.timeline, script.wall
    )
    (wanted.out / "rgb").mkdir(parents=True)
    for number, frame in enumerate(film):
        name = f"{number:05d}.png"
        left = cv2.imread(str(wanted.film / "rgb" / name))
        cv2.imwrite(str(wanted.out / "rgb" / name), np.hstack([left, cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)]))
    write_rig(wanted.out / "rig.yaml", camera.matrix, (camera.width, camera.height), wanted.baseline)


if __name__ == "__main__":
    main()
