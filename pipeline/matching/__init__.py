"""Which features of two keyframes are the same, and by which similarity: pictures and points, no map.

Public: `sift.detect_sift`, `keyframe_features.lift_features` (features with 3-D points), `place_recognition.retrieve`,
`sim3_match.verify_match` (the one verified match, for submap merging and for loop closing), `feature_tracks`,
`feature_matching.match_features` (features of posed keyframes, matched where the poses expect them).
"""
