"""Dense depth to one surface per submap, in millimetres where a scale is known, and what of the wall was missed.

Public: `fusion_stage.fuse_depth` and `load_surfaces`, `coverage_stage.coverage_stage`, `scale.ScaleSource`.
`depth_filter` decides which depth is fused.
"""
