"""SIFT features and sequential matches by COLMAP alone, for every benchmark that has it as a peer."""

from pathlib import Path

import cv2  # noqa: F401 - before pycolmap: see pipeline/frontend/colmap/worker.py
import pycolmap

from haustra.core.camera import read_camera

OVERLAP, PEAK_THRESHOLD, MAX_FEATURES = 8, 0.002, 2048  # as `reconstruct` has them


def extract_and_match(folder: Path, database: Path, mask: Path | None = None) -> None:
    """Fill a database from an RGB-D folder's images, with the true lens and, if given, one mask for all of them."""
    camera = read_camera(folder / "camera.json")
    extraction = pycolmap.FeatureExtractionOptions()
    extraction.use_gpu = False
    extraction.sift.peak_threshold, extraction.sift.max_num_features = PEAK_THRESHOLD, MAX_FEATURES
    reader = pycolmap.ImageReaderOptions()
    reader.camera_model, reader.camera_params = camera.model, ",".join(map(str, camera.params))
    if mask is not None:
        reader.camera_mask_path = mask
    pycolmap.extract_features(
        database,
        folder / "rgb",
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=reader,
        extraction_options=extraction,
        device=pycolmap.Device.cpu,
    )
    pairing = pycolmap.SequentialPairingOptions()
    pairing.overlap, pairing.quadratic_overlap = OVERLAP, False
    matching = pycolmap.FeatureMatchingOptions()
    matching.use_gpu = False
    pycolmap.match_sequential(database, matching, pairing, device=pycolmap.Device.cpu)
