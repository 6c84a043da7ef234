"""Readers of the field's RGB-D data sets: one generator each, by the layout and encoding that each documents.

A new one is a file with its generator and a row of `READERS` (docs/extending.md).

rgbd        haustra's own folder: rgb/, depth/, camera.json
simcol3d    SimCol3D: FrameBuffer_0000.png, Depth_0000.png
c3vd        C3VD v1: 0000_color.png, 0000_depth.tiff, flat
c3vdv2      C3VDv2: rgb/0000.png, depth/0000_depth.tiff
unitycam    EndoSLAM's UnityCam (VR-Caps): Frames/image_0000.png, Pixelwise Depths/aov_image_0000.png
vrcaps      VR-Caps with EXR depth, as EndoMapper's simulated sequences: rgb/*.png, depth/*.exr
ccd         UCL Colonoscopy CG Dataset: *.png with *_depth.png, or images/ and depths/
ccd_flat    the same as it is handed out: T1_FrameBuffer_0000.png beside T1_Depth_0000.png
csd         Colonoscopy Simulator Dataset (Zhang): SUK_L00001.png, SUK_L_depth00001.exr
csd_cases   the same in its second repository: Case1/rgb/*.png, Case1/depth_gt/*.exr
scared      SCARED: keyframe_1/Left_Image.png, keyframe_1/left_depth_map.tiff
scared_frames  the same as AF-SfMLearner lays it out: image_02/data/*.png, image_02/data/groundtruth/scene_points*.tiff
hamlyn      Hamlyn, rectified by Endo-Depth-and-Motion: image01/*.jpg, depth01/*.png
hamlyn_tracking  its part for tracking: color/*.jpg, depth/*.png
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from completion.data.evaluation_frame import EvaluationFrame, partner, read_depth16, read_exr, read_image, read_rgb
from completion.data.laparoscopes import hamlyn, scared, scared_frames
from haustra.core.errors import CompletionError
from haustra.core.text import read_json

PICTURES = {".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff"}  # of an RGB-D folder; its depth is always PNG
SIMCOL_FULL_MM = 200.0  # full scale is 20 cm ...
SIMCOL_STEPS = 256 * 255  # ... at this value, not at 65535: SimCol3D's own reader
SIMCOL_LENS = (227.60416, 227.60416, 237.5, 237.5)  # cam.txt's third number is a known slip; 237.5 is half of 475
C3VD_FULL_MM, C3VD_STEPS = 100.0, 65535  # the last step itself means "100 mm or more": no depth
CCD_PICTURES = "[!.]*_FrameBuffer_*.png"
CSD_MM = 5.0  # per unit of the EXR
CSD_LENS = (232.5045, 232.5045, 240.0, 320.0)
CSD_CASES_LENS = (155.0029785575049, 155.0029785575049, 120.0, 160.0)  # at 240 x 320
VRCAPS_LENS = (472.64955, 472.64955, 480.0, 360.0)  # at 960 x 720; published as 479.5, 359.5, from the pixel's centre
UNITYCAM_LENS = (156.0418, 155.7529, 178.5604, 181.8043)  # plus a radial term that is ignored here


def _rgbd(folder: Path) -> Iterator[EvaluationFrame]:
    about = read_json(folder / "camera.json")
    if "depth_unit_mm" not in about:
        raise CompletionError(f"{folder}/camera.json names no depth_unit_mm: no folder of true depth")
    if about.get("depth") == "sensor":
        raise CompletionError(
            f"{folder}/camera.json says that its depth is a sensor's, which is no truth: give the folder of true depth"
        )
    try:
        lens = np.array([float(value) for value in about["params"][:4]]) if "params" in about else None
        unit_mm = np.float32(float(about["depth_unit_mm"]))
    except (TypeError, ValueError, OverflowError) as error:
        numbers = "params and depth_unit_mm as numbers"
        raise CompletionError(f"{folder}/camera.json must give {numbers} ({error})") from error
    if not 0 < unit_mm < np.inf:
        raise CompletionError(f"depth_unit_mm in {folder}/camera.json is {unit_mm:g}, no length of a step of the depth")
    pictures = (path for path in (folder / "rgb").glob("[!.]*") if path.suffix.lower() in PICTURES)
    for path in sorted(pictures):
        depth = read_depth16(partner(path, folder / "depth", f"{path.stem}.png")).astype(np.float32) * unit_mm
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "mm", lens, folder.name)


def _simcol3d(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted(folder.glob("FrameBuffer_*.png")):
        raw = read_depth16(partner(path, folder, path.name.replace("FrameBuffer", "Depth")))
        depth = raw.astype(np.float32) * np.float32(SIMCOL_FULL_MM / SIMCOL_STEPS)
        # Frames_S1 ... S15, B, O are paths through three meshes: the letter names the mesh.
        group = folder.name.removeprefix("Frames_")[:1] or folder.name
        yield EvaluationFrame(path.stem.split("_")[-1], read_rgb(path), depth, "mm", _lens(SIMCOL_LENS), group)


def _c3vd(folder: Path) -> Iterator[EvaluationFrame]:
    # Not every clip pads its numbers with zeros: sort by value.
    for path in sorted(folder.glob("[!.]*_color.png"), key=lambda path: int(path.stem.split("_")[0])):
        number = path.stem.split("_")[0]
        raw = read_depth16(partner(path, folder, f"{number}_depth.tiff"))
        yield EvaluationFrame(number, read_rgb(path), _c3vd_depth(raw), "mm", None, _segment(folder.name))


def _c3vdv2(folder: Path) -> Iterator[EvaluationFrame]:
    # As above: of names that are numbers the shorter is the smaller.
    for path in sorted((folder / "rgb").glob("[!.]*.png"), key=lambda path: (len(path.stem), path.stem)):
        raw = read_depth16(partner(path, folder / "depth", f"{path.stem}_depth.tiff"))
        yield EvaluationFrame(path.stem, read_rgb(path), _c3vd_depth(raw), "mm", None, _segment(folder.name))


def _unitycam(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted((folder / "Frames").glob("image_*.png")):
        raw = read_rgb(partner(path, folder / "Pixelwise Depths", f"aov_{path.name}"))
        depth = raw[..., 0].astype(np.float32) / np.float32(255)
        # The AOV image has no documented unit: it must never be called millimetres.
        yield EvaluationFrame(
            path.stem.split("_")[-1], read_rgb(path), depth, "scene", _lens(UNITYCAM_LENS), folder.name
        )


def _vrcaps(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted((folder / "rgb").glob("[!.]*.png")):
        depth = _positive(read_exr(partner(path, folder / "depth", f"{path.stem}.exr")))
        # info.txt says decimetres, users doubt it.
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "scene", _lens(VRCAPS_LENS), folder.name)


def _ccd(folder: Path) -> Iterator[EvaluationFrame]:
    """Layout as users describe it, since none is documented: 256 x 256, depth PNG with 20 cm at full scale."""
    for path in sorted((folder / "images").glob("[!.]*.png")):
        raw = read_depth16(partner(path, folder / "depths", path.name))
        depth = raw.astype(np.float32) * np.float32(SIMCOL_FULL_MM / 65535)
        lens = np.array(SIMCOL_LENS) * raw.shape[1] / 475  # the same virtual camera at another size
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "mm", lens, folder.name)


def _ccd_flat(folder: Path) -> Iterator[EvaluationFrame]:
    """The set as it is handed out: 8- or 16-bit depth, 20 cm at full scale."""
    by_number = {path: [int(digits) for digits in re.findall(r"\d+", path.stem)] for path in folder.glob(CCD_PICTURES)}
    for path in sorted(by_number, key=lambda path: (by_number[path], path.name)):
        raw = read_image(partner(path, folder, path.name.replace("FrameBuffer", "Depth")), cv2.IMREAD_UNCHANGED)
        raw = raw if raw.ndim == 2 else raw[..., 0]
        depth = raw.astype(np.float32) * np.float32(SIMCOL_FULL_MM / np.iinfo(raw.dtype).max)
        lens = np.array(SIMCOL_LENS) * raw.shape[1] / 475
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "mm", lens, path.name.split("_FrameBuffer")[0])


def _csd_cases(folder: Path) -> Iterator[EvaluationFrame]:
    """zsustc/synthetic_colonoscopy_datasets: Case#/rgb and Case#/depth_gt, in order of their names."""
    pictures, depths = (
        sorted((folder / name).glob(end)) for name, end in (("rgb", "[!.]*.png"), ("depth_gt", "[!.]*.exr"))
    )
    if len(pictures) != len(depths):
        raise CompletionError(f"{folder} has {len(pictures)} pictures in rgb/ and {len(depths)} in depth_gt/")
    for path, truth in zip(pictures, depths, strict=True):
        depth = _positive(read_exr(truth)) * np.float32(CSD_MM)
        yield EvaluationFrame(path.stem, read_rgb(path), depth, "mm", _lens(CSD_CASES_LENS), folder.name)


def _csd(folder: Path) -> Iterator[EvaluationFrame]:
    for path in sorted(folder.glob("SUK_L[0-9]*.png")):
        number = path.stem.removeprefix("SUK_L")
        depth = _positive(read_exr(partner(path, folder, f"SUK_L_depth{number}.exr"))) * np.float32(CSD_MM)
        yield EvaluationFrame(number, read_rgb(path), depth, "mm", _lens(CSD_LENS), folder.name)


@dataclass(frozen=True)
class Reader:
    """How a data set is recognised and read."""

    pattern: str  # a file that only this layout has
    read: Callable[[Path], Iterator[EvaluationFrame]]


READERS = {
    "simcol3d": Reader("FrameBuffer_*.png", _simcol3d),
    "c3vd": Reader("[!.]*_depth.tiff", _c3vd),
    "c3vdv2": Reader("depth/[!.]*_depth.tiff", _c3vdv2),
    "unitycam": Reader("Pixelwise Depths/aov_image_*.png", _unitycam),
    "vrcaps": Reader("depth/[!.]*.exr", _vrcaps),
    "ccd": Reader("depths/[!.]*.png", _ccd),
    "ccd_flat": Reader(CCD_PICTURES, _ccd_flat),
    "csd_cases": Reader("depth_gt/[!.]*.exr", _csd_cases),
    "csd": Reader("SUK_L_depth*.exr", _csd),
    "scared": Reader("keyframe_*/left_depth_map.tiff", scared),
    "scared_frames": Reader("image_02/data/groundtruth/scene_points*.tiff", scared_frames),
    "hamlyn": Reader("depth01/[!.]*.png", hamlyn),
    "hamlyn_tracking": Reader("color/[!.]*.jpg", hamlyn),
    "rgbd": Reader("camera.json", _rgbd),  # last: others have such a file too, for `reconstruct`
}


def recognise(folder: Path) -> str:
    """Name of the layout of a folder; CompletionError, which names what was looked for, if it is none."""
    for name, reader in READERS.items():
        if next(folder.glob(reader.pattern), None) is not None:
            return name
    known = ", ".join(f"{name} ({reader.pattern.replace('[!.]', '')})" for name, reader in READERS.items())
    raise CompletionError(f"{folder} is no data set that can be read; looked for {known}")


def read_evaluation_frames(folder: Path, kind: str | None = None) -> Iterator[EvaluationFrame]:
    """Frames in order of their numbers. `kind` is a name above; None recognises it by its files."""
    folder = Path(folder)
    if kind is not None and kind not in READERS:
        raise CompletionError(f"no data set {kind!r}; known: {', '.join(READERS)}")
    yield from READERS[kind or recognise(folder)].read(folder)


def _lens(params: tuple[float, ...]) -> np.ndarray:
    return np.array(params, float)


def _positive(depth: np.ndarray) -> np.ndarray:
    return np.where(np.isfinite(depth) & (depth > 0), depth, 0).astype(np.float32)


def _c3vd_depth(raw: np.ndarray) -> np.ndarray:
    """uint16 to mm; both 0 and the clamped last step are no depth. Its lens is Scaramuzza's: no pinhole is given."""
    depth = raw.astype(np.float32) * np.float32(C3VD_FULL_MM / C3VD_STEPS)
    return np.where(raw == C3VD_STEPS, np.float32(0), depth)


def _segment(clip: str) -> str:
    """The part of a clip's name that names its mesh: cecum_t1_a -> cecum, c1_cecum_t1_v3 -> c1_cecum."""
    parts = clip.split("_")
    return "_".join(parts[: next((i for i, part in enumerate(parts) if part[:1] == "t" and part[1:].isdigit()), 1)])
