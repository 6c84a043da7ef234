"""Mouths of diverticula that a mesh closes with a lid.

    haustra phantom FILMS --suite --config benchmarks/diverticula.yaml
    python -m benchmarks.lids FILMS/* --json lids.json
    python -m benchmarks.lids RUN=FILM... --json lids.json   # of runs that are there already

For each diverticulum of a phantom film, rays go outward along its axis through points spread over the inner 70 % of
its mouth, from in front of the wall. The axis is the normal of the true wall around the mouth. A ray is *closed* if the
mesh stands within 1.5 mm of the mouth's plane where the true wall lies over 3 mm behind it. A mouth is judged if the
mesh has wall around it, on half or more of a ring at 1.4 radii, and if half or more of its rays are that deep in truth.
It is closed if half or more of its deep rays are; else it is open: a hole, or the pouch itself. The mesh is moved by
the Sim(3) of the posed frames. Each run has two meshes: with and without the spots that are too dark for their depth
(`fusion.open_dark_spots`), and the F-score of both at 1 mm. What was opened is counted, and how much of it was within
1 mm of the true wall: a mouth's shallow lip, or wall that was opened wrongly.
"""

import argparse
import json
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from benchmarks.common.runner import run
from benchmarks.fusion.comparison import pair
from benchmarks.fusion.measured_run import TAU, MeasuredRun, errors_of
from haustra.core.progress import SilentProgress
from pipeline.config import Config
from pipeline.finished_run import Run, open_run
from pipeline.run import reconstruct
from pipeline.surface.fusion_stage import SurfaceSettings, fuse_submap
from pipeline.surface.scale import ScaleSource
from reconstruction.mesh.mesh_io import read_mesh
from reconstruction.mesh.open3d_import import import_open3d, ray_scene
from reconstruction.mesh.surface_mesh import SurfaceMesh

INNER, RING = 0.7, 1.4  # mouth radii
LID_MM, DEEP_MM, BEFORE_MM = 1.5, 3.0, 4.0
RINGS, SECTORS = 4, 16
MESHES = {"as completed": False, "dark spots open": True}  # name: `fusion.open_dark_spots`
Array = NDArray[np.float64]


def reaches(mesh: SurfaceMesh, starts: Array, direction: Array) -> Array:
    """Distance (N,) from starts (N,3) along a unit direction (3,) to the mesh; infinite without a hit."""
    scene = ray_scene(mesh.vertices, mesh.faces)
    rays = np.concatenate([starts, np.broadcast_to(direction, starts.shape)], axis=1).astype(np.float32)
    return scene.cast_rays(rays)["t_hit"].numpy().astype(float)


def outward_axis(wall: SurfaceMesh, centre: Array, radius: float) -> Array:
    """Unit normal (3,) of the true wall around a mouth, away from the lumen: towards the pouch's own vertices."""
    offset = wall.vertices - centre
    distance = np.linalg.norm(offset, axis=1)
    around = offset[(distance > 1.2 * radius) & (distance < 2.2 * radius)]
    axis = np.linalg.svd(around - around.mean(axis=0), full_matrices=False)[2][2]
    along = offset @ axis
    lateral = np.linalg.norm(offset - along[:, None] * axis, axis=1)
    pouch = along[(lateral < radius) & (distance < 4 * radius)]
    return axis if pouch.mean() > 0 else -axis


def disc(centre: Array, axis: Array, radii: Array) -> Array:
    """Points (N,3) on rings of the given radii about a centre, across an axis, BEFORE_MM in front of the plane."""
    first = np.linalg.svd(axis[None])[2][1]
    second = np.cross(axis, first)
    angle = np.linspace(0, 2 * np.pi, SECTORS, endpoint=False)
    ring = np.cos(angle)[:, None] * first + np.sin(angle)[:, None] * second
    return (centre - BEFORE_MM * axis + radii[:, None, None] * ring).reshape(-1, 3)


def judge_mouth(mesh: SurfaceMesh, wall: SurfaceMesh, centre: Array, radius: float) -> dict[str, Any]:
    """Whether one mouth can be judged, and the share of its deep rays that meet a lid."""
    axis = outward_axis(wall, centre, radius)
    inner = disc(centre, axis, np.linspace(0.15, INNER, RINGS) * radius)
    around = reaches(mesh, disc(centre, axis, np.array([RING * radius])), axis) - BEFORE_MM
    true, found = (reaches(surface, inner, axis) - BEFORE_MM for surface in (wall, mesh))
    deep = true > DEEP_MM
    judged = (np.abs(around) < 2 * LID_MM).mean() >= 0.5 and deep.mean() >= 0.5
    closed = float((np.abs(found[deep]) < LID_MM).mean()) if deep.any() else 0.0
    return {"judged": bool(judged), "closed_share": closed}


def meshes_of(finished: Run) -> dict[str, SurfaceMesh]:
    """The main mesh of a run in scene units, without and with the spots left open that are too dark for their depth."""
    config, completed = finished.workspace.config, finished.completed_submaps[0]
    meshes = {}
    for name, is_open in MESHES.items():
        fusion = config.fusion.model_copy(update={"open_dark_spots": is_open})
        settings = SurfaceSettings(fusion, config.consistency, ScaleSource(), config.seed)
        meshes[name] = fuse_submap(completed, settings, name, SilentProgress()).mesh
    return meshes


def judged_run(run_folder: Path, film: Path) -> dict[str, Any]:
    """F-score in percent of both meshes, and every diverticulum of the film on each."""
    measured, wall = MeasuredRun(run_folder, film), read_mesh(film / "mesh.ply")
    known = json.loads((film / "diverticula.json").read_text())
    found: dict[str, Any] = {}
    surfaces: list[SurfaceMesh] = []
    for name, mesh in meshes_of(open_run(run_folder)).items():
        moved = mesh.transformed(measured.after.truth_from_map)
        mouths = [judge_mouth(moved, wall, np.array(one["centre"]), one["mouth_radius_mm"]) for one in known]
        found[name] = {"f_percent": 100 * errors_of(moved, measured.truth)["f_score"], "mouths": mouths}
        surfaces.append(moved)
    return found | {"opened": opened(surfaces[0], surfaces[1], wall)}


def opened(closed: SurfaceMesh, other: SurfaceMesh, wall: SurfaceMesh) -> dict[str, float]:
    """Percent of a mesh's vertices that the other mesh lacks, and percent of these within 1 mm of the true wall."""
    gone = closed.vertices[cKDTree(other.vertices).query(closed.vertices)[0] > 0]
    points = import_open3d().core.Tensor(gone.astype(np.float32))
    away = ray_scene(wall.vertices, wall.faces).compute_distance(points).numpy() if len(gone) else np.zeros(0)
    share = float((away < TAU).mean()) if len(gone) else 0.0
    return {"percent": 100 * len(gone) / max(len(closed.vertices), 1), "on_wall_percent": 100 * share}


def judged_film(given: str) -> tuple[str, dict[str, Any]]:
    """A film's name and both meshes: of the run that is given with it, or of a new one, lens given."""
    if "=" in given:
        run_folder, film = pair(given)
        return film.name, judged_run(run_folder, film)
    film = Path(given)
    with tempfile.TemporaryDirectory() as scratch:
        made = reconstruct(film, Path(scratch) / "run", Config(camera=str(film / "camera.json")))
        return film.name, judged_run(made.folder, film)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("films", metavar="[RUN=]FILM", nargs="+", help="phantom film; without a finished run it is run")


def measure(arguments: argparse.Namespace) -> dict[str, Any]:
    """Every film, and all mouths together."""
    films = dict(judged_film(given) for given in arguments.films)
    figures: dict[str, Any] = {"films": films}
    for name in MESHES:
        judged = [mouth for film in films.values() for mouth in film[name]["mouths"] if mouth["judged"]]
        closed = sum(mouth["closed_share"] >= 0.5 for mouth in judged)
        figures[name] = {"closed": closed, "judged": len(judged)}
        print(f"{name}: {closed} of {len(judged)} judged mouths are closed")
        print(
            "    F-score: " + ", ".join(f"{film} {meshes[name]['f_percent']:.1f} %" for film, meshes in films.items())
        )
    return figures


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.lids")
