"""Dense depth and poses to a surface, its coverage, and errors against truth. Imports nothing heavy at once.

- `SurfaceFusion`: RGB-D frames into a TSDF; `extract()` gives a `SurfaceMesh`.
- `read_mesh`, `write_mesh`: `SurfaceMesh` in and out of PLY, GLB, OBJ, STL.
- `measure_coverage`: the share of the lumen's wall that was seen, and the regions missed.
- `trajectory_errors`: ATE and rotation errors after alignment.
"""

from typing import TYPE_CHECKING

from haustra.core.lazy_names import lazy_names

if TYPE_CHECKING:
    from reconstruction.coverage.coverage import measure_coverage as measure_coverage
    from reconstruction.evaluation.trajectory_metrics import trajectory_errors as trajectory_errors
    from reconstruction.fusion.tsdf import SurfaceFusion as SurfaceFusion
    from reconstruction.mesh.mesh_io import read_mesh as read_mesh
    from reconstruction.mesh.mesh_io import write_mesh as write_mesh
    from reconstruction.mesh.surface_mesh import SurfaceMesh as SurfaceMesh

_MODULE_OF = {
    "SurfaceFusion": "reconstruction.fusion.tsdf",
    "SurfaceMesh": "reconstruction.mesh.surface_mesh",
    "measure_coverage": "reconstruction.coverage.coverage",
    "read_mesh": "reconstruction.mesh.mesh_io",
    "trajectory_errors": "reconstruction.evaluation.trajectory_metrics",
    "write_mesh": "reconstruction.mesh.mesh_io",
}
__all__ = ["SurfaceFusion", "SurfaceMesh", "measure_coverage", "read_mesh", "trajectory_errors", "write_mesh"]
__getattr__ = lazy_names(__name__, _MODULE_OF)
