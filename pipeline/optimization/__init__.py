"""Bundle adjustment on arrays: no map, no keyframe, no file.

Public: `bundle_adjustment.Bundle` and `adjust` (Levenberg-Marquardt on the Schur complement of the points),
`resection` (camera poses from points) and `triangulation` (points from rays). `kernels` are the compiled loops over
observations, `schur` the cameras' banded normal equations.
"""
