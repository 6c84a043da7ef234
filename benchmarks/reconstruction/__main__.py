"""What `reconstruct` poses and builds, beside truth, the authors' own poses, and COLMAP."""

from benchmarks.common.runner import choose

if __name__ == "__main__":
    choose(
        "benchmarks.reconstruction",
        __doc__,
        [
            "accuracy",
            "beside_true_depth",
            "front_ends",
            "mapper_seeds",
            "real_endoscopy",
            "depth_against_truth",
            "phantom_sfm",
            "kiss_icp",
            "known_poses",
            "blind_stretch",
            "sensors",
            "foreign_poses",
            "unknown_lens",
        ],
    )
