"""From a video, image folder or RGB-D folder to judged working frames on disk and their camera.

Public: `frames.read_frames`, `frames.load_frames` and `frames.Frames`; `video.Source`; `calibration.check_choice`.
"""
