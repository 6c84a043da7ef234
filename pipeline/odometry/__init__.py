"""Front end `odometry`: poses and points frame by frame, at video rate, in submaps that outlive loss of tracking.

`front_end` is the door. Below it: `odometry` (the state machine), `tracker` (features), `start` (two views), `mapping`
(keyframes, points, bundle adjustment), `merging` (submaps that saw the same place), `outcome` (the `Submap`).
"""
