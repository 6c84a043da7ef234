"""`haustra live SOURCE`: a surface that grows while the scope moves, then the ordinary run of what was recorded.

Three processes. This one reads (`capture`) and tracks (`live_tracking`) at the source's rate, and serves the page
(`page`). One completes and fuses keyframes as they settle (`dense_worker`). One closes loops and measures coverage now
and then (`review_worker`). What cannot be kept up with is skipped and counted, never queued without bound. `session`
holds them together; `live_run` is the command's work, with the run of the recording by `finish`.
"""
