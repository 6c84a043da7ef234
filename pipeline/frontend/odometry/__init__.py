"""Front end `odometry`: poses and points frame by frame, in submaps that outlive loss of tracking.

`front_end.track_frames` feeds frames to `tracking.Odometry`, which starts a map (`initialization`, `two_view`),
follows it (`tracking.Tracker`, on corners of `klt`) and starts anew when lost; `scale_breaks` finds where a map's scale
breaks, and it is cut there. `self_calibration` refines a guessed lens; `chunks` tracks a long video in parts. Maps,
their adjustment and their merging are in `pipeline.mapping`.
"""
