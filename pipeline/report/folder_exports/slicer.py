"""3D Slicer: the mesh in LPS, the camera's path as a curve, the missed regions as points (`.mrk.json`).

The run's world has no anatomical axes: its x, y and z are called left, posterior and superior, so that all files of one
run fit each other. Registration to a patient is Slicer's. Format of markups: Slicer's markups-schema-v1.0.3.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from haustra.core.errors import HaustraError
from pipeline.finished_run import Run
from pipeline.report.folder_exports.keyframe_views import empty_folder
from pipeline.report.page.scene import clock_words
from pipeline.run_folder.workspace import write_json
from reconstruction.mesh.formats.ply import write_ply

SCHEMA = (
    "https://raw.githubusercontent.com/slicer/slicer/master/Modules/Loadable/Markups/Resources/Schema/"
    "markups-schema-v1.0.3.json#"
)
IDENTITY = [1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0]
MOST_CURVE_POINTS = 500  # Slicer draws a handle at each


def export_slicer(run: Run, target: Path) -> Path:
    """Write mesh.ply, path.mrk.json and, where there are any, missed_regions.mrk.json; returns the folder."""
    if run.unit() != "mm":
        raise HaustraError(
            "Slicer measures in mm, and this run has no scale: give its command again with --resume and --lumen-mm, "
            "--scale or --poses-mm, or with --overwrite and the depth of --stereo or --depth sensor"
        )
    folder = empty_folder(target)
    write_ply(run.surfaces[0].mesh, folder / "mesh.ply", comments=("SPACE=LPS",))
    seconds, world_from_camera = run.trajectory()
    chosen = np.unique(np.linspace(0, len(seconds) - 1, min(MOST_CURVE_POINTS, len(seconds))).round().astype(int))
    labels = [f"{seconds[row]:.2f} s" for row in chosen]
    points = _points(world_from_camera[chosen, :3, 3], labels, [""] * len(labels))
    write_json(folder / "path.mrk.json", _markups("Curve", "camera path", points))
    regions = run.coverage[0].get("missed_regions", [])
    if regions:
        centres = np.array([region["centre"] for region in regions], float)
        descriptions = [f"missed: {r['area']:.0f} mm^2, {clock_words(r)}, {r['seconds']:.1f} s" for r in regions]
        points = _points(centres, [f"missed {region['number']}" for region in regions], descriptions)
        write_json(folder / "missed_regions.mrk.json", _markups("Fiducial", "missed regions", points))
    return folder


def _points(places: NDArray[np.float64], labels: list[str], descriptions: list[str]) -> list[dict[str, Any]]:
    return [
        {
            "id": str(number),
            "label": label,
            "description": description,
            "associatedNodeID": "",
            "position": [float(value) for value in place],
            "orientation": IDENTITY,
            "selected": True,
            "locked": True,
            "visibility": True,
            "positionStatus": "defined",
        }
        for number, (place, label, description) in enumerate(zip(places, labels, descriptions, strict=True), start=1)
    ]


def _markups(kind: str, name: str, points: list[dict[str, Any]]) -> dict[str, Any]:
    markup = {
        "type": kind,
        "name": name,
        "coordinateSystem": "LPS",
        "coordinateUnits": "mm",
        "locked": True,
        "fixedNumberOfControlPoints": False,
        "labelFormat": "%N-%d",
        "lastUsedControlPointNumber": len(points),
        "controlPoints": points,
        "measurements": [],
        "display": {"visibility": True, "pointLabelsVisibility": kind != "Curve"},
    }
    return {"@schema": SCHEMA, "markups": [markup]}
