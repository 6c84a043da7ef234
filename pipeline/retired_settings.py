"""Settings of version 0.1 that are gone or have other names: in settings files they are refused or renamed, in the
records of runs they are read."""

# Names of version 0.1 in run.yaml and --config files, and what they are called today.
RENAMED = {
    "depth.looks": "depth.iterations",
    "pose_graph.enabled": "loop_closing.enabled",
    "pose_graph.join": "loop_closing.merge_submaps",
    "pose_graph.max_places": "loop_closing.max_keyframes",
}
# Settings whose place another has taken, which means something else, and their defaults: no other value can be kept.
REPLACED = {"fusion.max_depth_ratio": ("fusion.max_error_voxels", 2.0)}
# Settings of version 0.1 that nobody set, and their defaults.
RETIRED: dict[str, float] = {
    "frames.min_brightness": 8.0,
    "frames.max_burnt": 0.6,
    "frames.min_texture": 1.2,
    "frames.min_relative_sharpness": 0.3,
    "frames.min_change": 0.35,
    "structure.peak_threshold": 0.002,
    "structure.max_features": 2048,
    "structure.overlap": 8,
    "structure.loop_neighbours": 2,
    "structure.loop_stride": 10,
    "structure.threads": 2,
    "structure.min_registered": 0.8,
    "structure.max_dark_near": 0.05,
    "sparse.max_reprojection_px": 1.5,
    "sparse.min_track_length": 3,
    "sparse.min_angle_deg": 1.0,
    "sparse.pixel_noise": 0.5,
    "sparse.neighbours": 4,
    "sparse.outlier_ratio": 0.25,
    "depth.min_points": 12,
    "depth.max_fov_deg": 120.0,
    "pose_graph.per_place": 3,
    "consistency.severity": 6.0,
    "consistency.max_contradicted": 0.5,
    "fusion.truncation_voxels": 12.0,
    "fusion.min_component": 0.02,
}
OLD_SECTIONS = ("structure", "sparse", "pose_graph")
# The values at which they are fixed; a run that has the default of 0.1 is gone on with all the same.
FIXED = RETIRED | {"fusion.truncation_voxels": 5.0}
