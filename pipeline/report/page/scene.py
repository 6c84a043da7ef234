"""What the 3-D view draws, as plain values for JSON: a coarse mesh, the path, keyframes' poses, missed regions."""

import base64
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.camera import Camera
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.input.frames import Frames
from pipeline.mapping.submap import Submap
from pipeline.report.page.keyframe_gallery import Shown
from pipeline.report.page.region_marks import mark_region
from pipeline.surface.coverage_stage import CoverageResult
from pipeline.surface.fusion_stage import Surface
from pipeline.surface.scale import unit_label
from reconstruction.mesh.decimation import decimated
from reconstruction.mesh.rendering import brightened, clearest_view
from reconstruction.mesh.surface_mesh import SurfaceMesh

TRIANGLES = 60_000  # of all submaps' meshes together
FEWEST_TRIANGLES = 2_000  # that a submap keeps, unless there are many:
FLOOR_SHARE = 0.25  # of all triangles are for what small submaps keep beyond their share
PATCH_TRIANGLES = 16_000  # of all missed regions together,
MOST_PATCH_TRIANGLES = 8_000  # and of a submap's
PATH_POINTS = 20_000  # of all camera paths together,
MOST_PATH_POINTS = 5_000  # and of a submap's


@dataclass(frozen=True)
class Limits:
    """What a submap may take of the page."""

    triangles: int
    patch_triangles: int
    path_points: int


def scene_data(
    frames: Frames,
    submaps: list[CompletedSubmap],
    surfaces: list[Surface],
    coverage: list[CoverageResult],
    shown: list[Shown],
) -> list[dict[str, Any]]:
    """One entry a submap; lengths in its output unit, in the axes of its `mesh.ply`."""
    total, count = max(1, sum(len(surface.mesh.faces) for surface in surfaces)), max(1, len(surfaces))
    fewest = min(FEWEST_TRIANGLES, int(FLOOR_SHARE * TRIANGLES / count))
    return [
        _submap(
            frames,
            completed,
            surface,
            result,
            Limits(
                max(fewest, TRIANGLES * len(surface.mesh.faces) // total),
                min(MOST_PATCH_TRIANGLES, PATCH_TRIANGLES // count),
                max(2, min(MOST_PATH_POINTS, PATH_POINTS // count)),
            ),
            {place: keyframe.row for place, keyframe in enumerate(shown) if keyframe.submap == number},
        )
        for number, (completed, surface, result) in enumerate(zip(submaps, surfaces, coverage, strict=True))
    ]


def finite(mesh: SurfaceMesh) -> SurfaceMesh:
    """The mesh without faces that have a corner nowhere; itself if there are none."""
    sound = np.asarray(np.isfinite(mesh.vertices).all(axis=1))
    return mesh if sound.all() else mesh.with_faces(np.asarray(sound[mesh.faces].all(axis=1)))


def _submap(
    frames: Frames,
    completed: CompletedSubmap,
    surface: Surface,
    result: CoverageResult,
    limits: Limits,
    shown: dict[int, int],
) -> dict[str, Any]:
    submap, unit = completed.submap.scaled(surface.scale.factor), unit_label(surface.scale.unit)
    coarse = decimated(surface.mesh, limits.triangles)
    rows = np.arange(0, len(submap.frames), max(1, -(-len(submap.frames) // limits.path_points)))
    world_from_camera = submap.world_from_camera
    points = np.concatenate([coarse.vertices, submap.centres])
    low, high = points.min(axis=0), points.max(axis=0)
    axes = _axes(coarse.vertices if len(coarse.faces) else submap.centres, world_from_camera)
    if len(coarse.faces):
        axes = _turned_to_lumen(axes, coarse)
    seen = points @ axes.T  # as the first view shows them
    return {
        "unit": unit,
        "triangles": len(coarse.faces),
        "all_triangles": len(surface.mesh.faces),
        "low": low.tolist(),
        "high": high.tolist(),
        "axes": axes.tolist(),
        "first_view": {
            "middle": ((seen.min(axis=0) + seen.max(axis=0)) / 2 @ axes).tolist(),
            "size": np.ptp(seen, axis=0).tolist(),
        },
        "view": _view(completed.camera),
        "mesh": _packed(coarse, brightened(coarse.colours)) if len(coarse.faces) else None,
        "path": {
            "places": _floats(submap.centres[rows]),
            "frames": submap.frames[rows].tolist(),
            "seconds": [round(frames.seconds_of(int(submap.frames[row])), 3) for row in rows],
        },
        "keyframes": {
            "places": _floats(submap.centres[completed.rows]),
            "frames": submap.frames[completed.rows].tolist(),
        },
        "shown": [{"keyframe": place, "pose": _pose(world_from_camera[row])} for place, row in shown.items()],
        "missed": _missed(result, limits.patch_triangles)
        | {"regions": _regions(result, unit, submap, shown, completed.camera)},
    }


def _packed(mesh: SurfaceMesh, colours: NDArray[Any]) -> dict[str, Any]:
    """Base64 of little-endian arrays; places in 65 536 steps of the mesh's own box."""
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    steps = np.round((mesh.vertices - low) / np.maximum(high - low, 1e-12) * 65535).astype("<u2")
    trust = np.nan_to_num(mesh.confidence, nan=0.0)
    return {
        "low": low.tolist(),
        "span": (high - low).tolist(),
        "vertices": _text(steps),
        "faces": _text(mesh.faces.astype("<u4")),
        "colours": _text(np.asarray(colours).astype(np.uint8)),
        "confidence": _text(np.round(255 * np.clip(trust, 0, 1)).astype(np.uint8)),
    }


def _missed(result: CoverageResult, triangles: int) -> dict[str, Any]:
    """The closing surface over the listed regions where it is known."""
    patches = [decimated(finite(patch), max(1, triangles // len(result.missed))) for patch in result.missed]
    starts = np.cumsum([0, *(len(patch.vertices) for patch in patches)])
    vertices = [patch.vertices for patch in patches] or [np.empty((0, 3))]
    faces = [patch.faces + start for patch, start in zip(patches, starts)] or [np.empty((0, 3))]
    return {
        "vertices": _floats(np.concatenate(vertices)),
        "faces": _text(np.concatenate(faces).astype("<u4")),
    }


def _regions(
    result: CoverageResult, unit: str, submap: Submap, shown: dict[int, int], camera: Camera
) -> list[dict[str, Any]]:
    """Of each listed region its number, words and middle; `keyframe`: place of the page's keyframe that shows its
    direction, None without one; `at`: where in the picture, None outside."""
    regions, rows, found = result.record.get("missed_regions", []), list(shown.values()), []
    poses, frames = submap.world_from_camera[rows], submap.frames[rows]
    for place, region in zip(_places(regions, result.missed), regions, strict=True):
        entry: dict[str, Any] = {"keyframe": None, "at": None}
        if rows:
            mark = mark_region(place, region["frame"], poses, frames, camera)
            entry = {"keyframe": list(shown)[mark.row], "at": mark.at}
        found.append(_told(region, unit) | entry)
    return found


def _places(regions: list[dict[str, Any]], patches: tuple[SurfaceMesh, ...]) -> list[NDArray[np.float64]]:
    """A place (3,) on each region: of its closing surface the nearest to its middle, which lies in the lumen where the
    region goes round it; the middle where that surface is not known."""
    middles = [np.array(region["centre"]) for region in regions]
    if len(patches) != len(regions):
        return middles
    return [
        of.vertices[np.argmin(np.linalg.norm(of.vertices - middle, axis=1))] if len(of.vertices) else middle
        for middle, of in zip(middles, map(finite, patches), strict=True)
    ]


def _told(region: dict[str, Any], unit: str) -> dict[str, Any]:
    return {
        "number": region["number"],
        "centre": region["centre"],
        "words": f"missed region {region['number']}: {region['area']:.3g} {unit}², as a disc "
        f"{region['diameter']:.3g} {unit} across; {region['arc']:.3g} {unit} along, {clock_words(region)}; "
        f"nearest frame {region['frame']} ({region['seconds']:.2f} s)",
    }


def _view(camera: Camera) -> list[float]:
    """Left, right, top and bottom of the picture at depth 1, camera axes."""
    (fx, fy), (cx, cy) = camera.focal, camera.centre
    return [-cx / fx, (camera.width - cx) / fx, -cy / fy, (camera.height - cy) / fy]


def clock_words(region: dict[str, Any]) -> str:
    return "all round" if region["clock"] is None else f"{region['clock']:.1f} o'clock"


def _axes(points: NDArray[np.float64], world_from_camera: NDArray[np.float64]) -> NDArray[np.float64]:
    """Rows: along the object's longest axis the way the camera went, up as the picture has it, and towards the eye."""
    along = np.linalg.eigh(np.cov(points.T))[1][:, -1] if len(points) > 1 else np.array([1.0, 0, 0])
    if along @ (world_from_camera[-1, :3, 3] - world_from_camera[0, :3, 3]) < 0:
        along = -along
    up = -world_from_camera[:, :3, 1].mean(axis=0)
    up -= (up @ along) * along
    if np.linalg.norm(up) < 1e-6:
        up = np.cross(along, [1.0, 0, 0] if abs(along[0]) < 0.9 else [0, 1.0, 0])
    up /= np.linalg.norm(up)
    return np.stack([along, up, np.cross(along, up)])


def _turned_to_lumen(axes: NDArray[np.float64], mesh: SurfaceMesh) -> NDArray[np.float64]:
    """The axes, or those of a view from the other side, from above or from below that shows clearly more of the lumen's
    side: wall that was seen on one side alone would be cut away."""
    along, up, towards = axes
    views = np.array([axes, (-along, up, -towards), (along, -towards, up), (along, towards, -up)])
    return np.asarray(views[clearest_view(mesh, -views[:, 2])])


def _pose(world_from_camera: NDArray[np.float64]) -> list[float]:
    """The first three rows of a pose, row by row."""
    return [round(float(value), 6) for value in world_from_camera[:3].ravel()]


def _floats(array: NDArray[np.float64]) -> str:
    return _text(array.astype("<f4"))


def _text(array: NDArray[Any]) -> str:
    return base64.b64encode(np.ascontiguousarray(array).tobytes()).decode()
