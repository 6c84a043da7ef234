"""An RGB-D folder with true depth, as a time-of-flight sensor at the tip would have seen it.

python scripts/simulated_sensor.py FOLDER OUT --zones 64 64 --noise 0.02

Zones of that many columns and rows, the depth of each from its middle pixel with Gaussian noise of a share of it; holes
where the wall is seen at a grazing angle or the picture is burnt out, and a twentieth of all zones at random. OUT is an
RGB-D folder whose camera.json says "depth": "sensor"; the truth stays in FOLDER.
"""

import argparse
import json
import shutil
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera, read_camera

DROPPED = 0.05
GRAZING = np.cos(np.radians(75))  # of the angle between ray and normal: beyond, too little light comes back
BURNT = 250  # grey level
UNIT_MM = 0.01
BLIND_PX = 12.0  # sigma of the blur that leaves nothing to track


def sensed(
    depth: NDArray[np.float64],
    rgb: NDArray[np.uint8],
    camera: Camera,
    zones: tuple[int, int],
    noise: float,
    rng: np.random.Generator,
    along_ray: bool = False,
) -> NDArray[np.float64]:
    """(rows, columns) depth in mm of true depth (H,W), 0 = none. along_ray: distance along each pixel's ray."""
    height, width = depth.shape
    y = ((np.arange(zones[1]) + 0.5) * height / zones[1]).astype(int)
    x = ((np.arange(zones[0]) + 0.5) * width / zones[0]).astype(int)
    columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    plane, known = camera.unproject(np.stack([columns.ravel(), rows.ravel()], axis=1))
    rays = np.column_stack([plane, np.ones(len(plane))]).reshape(height, width, 3)
    points = rays * depth[..., None]
    normal = np.cross(np.gradient(points, axis=1), np.gradient(points, axis=0))
    normal /= np.maximum(np.linalg.norm(normal, axis=2, keepdims=True), 1e-12)
    cosine = np.abs((normal * rays).sum(axis=2)) / np.linalg.norm(rays, axis=2)
    seen = (cosine > GRAZING) & (rgb.min(axis=2) < BURNT) & (depth > 0) & known.reshape(height, width)
    measured = depth * (1 + noise * rng.standard_normal(depth.shape))
    if along_ray:
        measured = measured * np.linalg.norm(rays, axis=2)
    kept = rng.random(depth.shape) > DROPPED
    return np.where(seen & kept, np.maximum(measured, 0), 0.0)[np.ix_(y, x)]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--zones", type=int, nargs=2, default=(64, 64))
    parser.add_argument("--noise", type=float, default=0.02)
    parser.add_argument("--factor", type=float, default=1.0, help="of all depths: a wrong unit")
    parser.add_argument("--along-ray", action="store_true", help="distances along each pixel's ray, not z-depth")
    parser.add_argument("--shift", type=int, default=0, help="frames by which the depth is late, negative: early")
    parser.add_argument("--blind", type=int, nargs=2, help="first and last frame whose picture is blurred away")
    parser.add_argument("--seed", type=int, default=0)
    wanted = parser.parse_args()
    about, camera = json.loads((wanted.folder / "camera.json").read_text()), read_camera(wanted.folder / "camera.json")
    rng = np.random.default_rng(wanted.seed)
    (wanted.out / "depth").mkdir(parents=True, exist_ok=True)
    shutil.copytree(wanted.folder / "rgb", wanted.out / "rgb", dirs_exist_ok=True)
    files = sorted((wanted.folder / "depth").glob("*.png"))
    for number, path in enumerate(files):
        late = files[int(np.clip(number - wanted.shift, 0, len(files) - 1))]
        true = cv2.imread(str(late), cv2.IMREAD_UNCHANGED) * about["depth_unit_mm"]
        rgb = cv2.imread(str(wanted.folder / "rgb" / path.name))
        seen = sensed(true, rgb, camera, tuple(wanted.zones), wanted.noise, rng, wanted.along_ray)
        depth = wanted.factor * seen
        cv2.imwrite(
            str(wanted.out / "depth" / path.name), np.clip(np.rint(depth / UNIT_MM), 0, 65535).astype(np.uint16)
        )
    for number in range(wanted.blind[0], wanted.blind[1] + 1) if wanted.blind else ():
        picture = wanted.out / "rgb" / files[number].name
        blurred = cv2.GaussianBlur(cv2.imread(str(picture)), (0, 0), BLIND_PX)
        cv2.imwrite(str(picture), blurred)
    told = about | {"depth": "sensor", "depth_unit_mm": UNIT_MM}
    (wanted.out / "camera.json").write_text(json.dumps(told))


if __name__ == "__main__":
    main()
