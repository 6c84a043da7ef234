"""Front end `odometry`: poses and points frame by frame, in submaps that outlive loss of tracking.

`front_end.track_frames` feeds frames to `tracking.Odometry`, which starts a map (`initialization`, `two_view`),
follows it (`tracking.Tracker`, on corners of `klt`) and starts anew when lost. `finish_maps` makes the last adjustments
and merges maps; `self_calibration` refines a guessed lens; `chunks` tracks a long video in parallel parts.
"""
