"""A `Submap` as a COLMAP model in text, and as the arrays that `read_submap` reads.

Written by hand, since pycolmap must not share this process with OpenCV (see frontend/colmap/worker). Format:
colmap.github.io/format.html.
"""

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from haustra.core.camera import Camera
from pipeline.mapping.submap import Submap, refined_camera

CAMERA_ID = 1


def write_model(submap: Submap, camera: Camera, folder: Path, colours: NDArray[np.uint8] | None = None) -> None:
    """What `write_arrays` writes, and for COLMAP cameras.txt, images.txt and points3D.txt.

    colours (P,3): of the points; grey if there are none. Image and point numbers are rows plus one. A lens that COLMAP
    lacks is a pinhole in the text files, and pixels are where that pinhole sees them; model.npz has the lens itself.
    """
    write_arrays(submap, folder)
    seen, lens = (submap, refined_camera(camera, submap)) if camera.lens.in_colmap else _by_pinhole(submap, camera)
    params = " ".join(repr(float(p)) for p in lens.params)
    (folder / "cameras.txt").write_text(f"{CAMERA_ID} {lens.model} {lens.width} {lens.height} {params}\n")
    with (folder / "images.txt").open("w") as file:
        file.writelines(_image_lines(seen))
    with (folder / "points3D.txt").open("w") as file:
        file.writelines(_point_lines(submap, colours))


def write_arrays(submap: Submap, folder: Path) -> None:
    """model.npz and, of a refined lens, camera_sigma.txt: all that `read_submap` reads."""
    folder.mkdir(parents=True, exist_ok=True)
    optional = {"followed": submap.klt, "depth_error": submap.depth_error}
    np.savez(
        folder / "model.npz",
        allow_pickle=False,
        names=np.array(_names(submap)),
        world_from_camera=submap.world_from_camera,
        points=submap.points,
        error_px=submap.error_px,
        observations=submap.observations,
        pixels=submap.pixels,
        camera_params=np.array(submap.camera_params),
        **{name: values for name, values in optional.items() if values is not None},
    )
    write_camera_sigma(folder, submap.camera_sigma)


def _names(submap: Submap) -> list[str]:
    return [f"{index:06d}.jpg" for index in submap.frames]


def write_camera_sigma(folder: Path, sigma: tuple[float, ...]) -> None:
    """Standard deviations of a refined lens beside a model; nothing where there are none."""
    if sigma:
        (folder / "camera_sigma.txt").write_text(" ".join(repr(float(s)) for s in sigma))


def _by_pinhole(submap: Submap, camera: Camera) -> tuple[Submap, Camera]:
    """The same rays through a pinhole of the lens's focal length and centre."""
    lens = refined_camera(camera, submap)
    pinhole = replace(lens, model="PINHOLE", params=(*lens.focal, *lens.centre))
    plane, _ = lens.unproject(submap.pixels)
    return replace(submap, pixels=plane * np.array(lens.focal) + np.array(lens.centre)), pinhole


def _image_lines(submap: Submap) -> Iterator[str]:
    order, starts = submap.by_frame()
    rotations = np.swapaxes(submap.world_from_camera[:, :3, :3], 1, 2)
    quaternions = Rotation.from_matrix(rotations).as_quat(canonical=True)
    for row, name in enumerate(_names(submap)):
        shift = -rotations[row] @ submap.centres[row]
        x, y, z, w = quaternions[row]
        yield f"{row + 1} {w:.17g} {x:.17g} {y:.17g} {z:.17g} {shift[0]:.17g} {shift[1]:.17g} {shift[2]:.17g} "
        yield f"{CAMERA_ID} {name}\n"
        mine = order[starts[row] : starts[row + 1]]
        # Python's own numbers: NumPy's take three times as long to print. Those of one frame, since all are gigabytes.
        point, pixels = (submap.observations[mine, 1] + 1).tolist(), submap.pixels[mine].tolist()
        yield " ".join(f"{u:.4f} {v:.4f} {p}" for (u, v), p in zip(pixels, point, strict=True)) + "\n"


def _point_lines(submap: Submap, colours: NDArray[np.uint8] | None) -> Iterator[str]:
    shades = np.full((len(submap.points), 3), 128) if colours is None else colours
    order, first = submap.by_frame()
    frame, point = submap.observations[order].T
    place = np.arange(len(frame)) - first[frame]  # of each observation within its image
    by_point = np.argsort(point, kind="stable")
    starts = np.searchsorted(point[by_point], np.arange(len(submap.points) + 1))
    begins, errors = starts.tolist(), submap.error_px.tolist()
    for row, ((x, y, z), (red, green, blue)) in enumerate(zip(submap.points.tolist(), shades.tolist(), strict=True)):
        mine = by_point[begins[row] : begins[row + 1]]
        seen = zip((frame[mine] + 1).tolist(), place[mine].tolist(), strict=True)
        track = " ".join(f"{f} {k}" for f, k in seen)
        yield f"{row + 1} {x:.17g} {y:.17g} {z:.17g} {red} {green} {blue} {errors[row]:.6g} {track}\n"
