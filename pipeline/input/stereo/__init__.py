"""A stereo endoscope: its calibration, the two pictures in a film, and depth by semi-global matching."""
