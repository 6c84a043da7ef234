"""Front end `odometry`: poses and points frame by frame, in submaps that outlive loss of tracking.

`front_end` is the door. Below it: `odometry` (the state machine), `lookahead` (the next frames meanwhile), `tracking`
(features), `start` (two views), `local_map` (keyframes, points), `bundle`, `schur` and `kernels` (their adjustment,
and its compiled loops), `keyframe_features`, `guided` and `refit` (the last one, to features found anew),
`self_calibration` (a guessed lens), `links` and `merging` (submaps that saw the same place), `chunks` and `seam` (a
long film in parts), `outcome` (the `Submap`).
"""
