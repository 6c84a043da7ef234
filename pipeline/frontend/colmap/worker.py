"""COLMAP in a process of its own: `python -m pipeline.frontend.colmap.worker match|map|scale|calibrate JOB.json`.

A process of its own for three reasons: Ctrl-C stops it at once, where C++ inside our process would not listen; a crash
in it is a sentence, not the end of the run; and importing pycolmap before OpenCV makes OpenCV's PNG writer abort
(pycolmap 4.2.1 and OpenCV 5.0.0 carry different zlibs), so the two are kept apart.

Progress goes to standard output as "done total" lines, COLMAP's own log to standard error.
"""

import json
import shutil
import sys
import time
from pathlib import Path
from typing import Any

import cv2  # noqa: F401 - before pycolmap, see above
import numpy as np
import pycolmap
from numpy.typing import NDArray

from pipeline.frontend.colmap.pairs import loops_to_try, sequential_pairs

BATCHES = 20  # steps of the progress bar
LEAST_DECREASE = 1e-6  # of the cost, relative: an adjustment that gains less has converged
# Matching and mapping with two threads differ from run to run of one seed; they gain a quarter and a tenth.
REPEATABLE_THREADS = 1


def extract_and_match(job: dict[str, Any]) -> None:
    """SIFT on every image within its mask, then verified matches along the sequence and across loops.

    `matching_until_s` after the start, where that is given, matching ends with the pairs that it has, since mapping
    must not be left without time. `matched.json` says how many they are.
    """
    started, until_s = time.monotonic(), job.get("matching_until_s", float("inf"))
    pycolmap.set_random_seed(job["seed"])
    _register(job)
    batches = _batches(job["images"])
    total = 2 * len(batches) + 1
    for done, names in enumerate(batches):
        _extract(job, names)
        _report(done + 1, total)
    pairs = sequential_pairs(job["images"], job["overlap"])
    pairs += loops_to_try(job, _descriptors(job))
    _report(len(batches) + 1, total)
    matched = 0
    for done, batch in enumerate(_batches(pairs)):
        if time.monotonic() - started > until_s:
            break
        _match(job, batch)
        matched += len(batch)
        _report(len(batches) + 2 + done, total)
    Path(job["scratch"], "matched.json").write_text(json.dumps({"matched": matched, "pairs": len(pairs)}))


def _register(job: dict[str, Any]) -> None:
    """Enter the images in order: extraction would number them as its threads finish, and mapping depends on that."""
    with pycolmap.Database.open(job["database"]) as db:
        known = db.num_images()
    if known == len(job["images"]):
        return
    mode = pycolmap.CameraMode.SINGLE
    pycolmap.import_images(job["database"], job["image_folder"], mode, job["images"], _reader(job))


def _reader(job: dict[str, Any]) -> pycolmap.ImageReaderOptions:
    reader = pycolmap.ImageReaderOptions()
    reader.mask_path = job["masks"]
    reader.camera_model = job["camera"]["model"]
    reader.camera_params = ",".join(repr(p) for p in job["camera"]["params"])
    return reader


def _extract(job: dict[str, Any], names: list[str]) -> None:
    options = pycolmap.FeatureExtractionOptions()
    options.use_gpu = False
    options.num_threads = job["threads"]
    options.sift.peak_threshold = job["peak_threshold"]
    options.sift.max_num_features = job["max_features"]
    pycolmap.extract_features(
        job["database"],
        job["image_folder"],
        image_names=names,
        camera_mode=pycolmap.CameraMode.SINGLE,
        reader_options=_reader(job),
        extraction_options=options,
        device=pycolmap.Device.cpu,
    )


def _descriptors(job: dict[str, Any]) -> list[NDArray[Any]]:
    """(N,128) of each of the job's images."""
    with pycolmap.Database.open(Path(job["database"])) as db:
        ids = {image.name: image.image_id for image in db.read_all_images()}
        return [np.asarray(db.read_descriptors(ids[name]).data) for name in job["images"]]


def _match(job: dict[str, Any], pairs: list[tuple[str, str]]) -> None:
    listed = Path(job["scratch"]) / "pairs.txt"
    listed.write_text("".join(f"{a} {b}\n" for a, b in pairs))
    options = pycolmap.FeatureMatchingOptions()
    options.use_gpu = False
    options.num_threads = REPEATABLE_THREADS
    pairing = pycolmap.ImportedPairingOptions()
    pairing.match_list_path = str(listed)
    verification = pycolmap.TwoViewGeometryOptions()
    verification.ransac.random_seed = job["seed"]
    pycolmap.match_image_pairs(job["database"], options, pairing, verification, device=pycolmap.Device.cpu)


def map_scene(job: dict[str, Any]) -> None:
    """Run one mapper; write each model as COLMAP files and as plain arrays."""
    pycolmap.set_random_seed(job["seed"])
    output = Path(job["output"])
    output.mkdir(parents=True, exist_ok=True)
    mapper = {"global": _map_globally, "incremental": _map_incrementally}[job["method"]]
    models = mapper(job, output)
    for number, model in enumerate(models.values()):
        _write(model, output / str(number))
    if job["refine_camera"]:  # last, since models that are written survive its failure
        sigmas = [camera_sigma(model) for model in models.values()]
        if share_lens(list(models.values()), sigmas, job["camera"]["params"]):
            for number, model in enumerate(models.values()):
                _write(model, output / str(number))
        best = sigmas[best_lens(list(models.values()), sigmas)] if sigmas else np.empty(0)
        for number in range(len(models)):
            (output / str(number) / "camera_sigma.txt").write_text(" ".join(map(str, best)))


def _write(model: pycolmap.Reconstruction, folder: Path) -> None:
    """As COLMAP's files and as plain arrays. The folder appears at once, since a worker that is late is killed, and
    what it left is taken for whole."""
    part = folder.parent.with_name(folder.parent.name + "_part") / folder.name
    for old in (part, folder):
        shutil.rmtree(old, ignore_errors=True)
    part.mkdir(parents=True)
    model.write_binary(part)
    np.savez(part / "model.npz", allow_pickle=False, **model_arrays(model))
    part.replace(folder)


def best_lens(models: list[pycolmap.Reconstruction], sigmas: list[NDArray[np.float64]]) -> int:
    """Number of the model whose focal length is determined best; of the first, the largest, where none is."""
    relative = [sigma[0] / camera_of(model).mean_focal_length() for model, sigma in zip(models, sigmas, strict=True)]
    return int(np.argmin(np.where(np.isfinite(relative), relative, np.inf)))


def share_lens(models: list[pycolmap.Reconstruction], sigmas: list[NDArray[np.float64]], guess: list[float]) -> bool:
    """All models were filmed by one camera: those that determine its lens less well take it from the one that does
    best, or all the guess where none does, and are adjusted with it. Whether any was changed."""
    if len(models) < 2:
        return False
    best = best_lens(models, sigmas)
    determined = bool(np.isfinite(sigmas[best][0]))
    lens = np.array(camera_of(models[best]).params) if determined else np.array(guess, float)
    for number, model in enumerate(models):
        if number == best and determined:
            continue
        camera_of(model).params = lens.tolist()
        options = pycolmap.BundleAdjustmentOptions()
        options.refine_focal_length = options.refine_principal_point = options.refine_extra_params = False
        options.print_summary = False
        options.ceres.solver_options.num_threads = REPEATABLE_THREADS
        pycolmap.bundle_adjustment(model, options)
    return True


def camera_of(model: pycolmap.Reconstruction) -> pycolmap.Camera:
    """The one camera of a model."""
    return next(iter(model.cameras.values()))


def _map_globally(job: dict[str, Any], output: Path) -> dict[int, pycolmap.Reconstruction]:
    options = pycolmap.GlobalPipelineOptions()
    options.num_threads = options.mapper.num_threads = REPEATABLE_THREADS
    options.random_seed = options.mapper.random_seed = job["seed"]
    options.mapper.bundle_adjustment.ceres.use_gpu = False
    options.mapper.bundle_adjustment.ceres.solver_options.num_threads = REPEATABLE_THREADS
    options.mapper.global_positioning.use_gpu = False
    options.mapper.bundle_adjustment.refine_focal_length = job["refine_camera"]
    options.mapper.bundle_adjustment.refine_extra_params = job["refine_camera"]
    return pycolmap.global_mapping(job["database"], job["image_folder"], output, options)


def _map_incrementally(job: dict[str, Any], output: Path) -> dict[int, pycolmap.Reconstruction]:
    options = pycolmap.IncrementalPipelineOptions()
    options.num_threads = REPEATABLE_THREADS
    options.random_seed = job["seed"]
    options.min_model_size = 3
    options.ba_refine_focal_length = options.ba_refine_extra_params = job["refine_camera"]
    options.mapper.init_min_tri_angle = 4.0  # a tube seen along its axis never reaches the default of 16 degrees
    return pycolmap.incremental_mapping(job["database"], job["image_folder"], output, options)


def camera_sigma(model: pycolmap.Reconstruction) -> NDArray[np.float64]:
    """Standard deviations of the refined camera parameters (focal length first), from the bundle adjustment's
    covariance with one pixel of noise; NaN where the problem does not determine them."""
    camera = camera_of(model)
    config = pycolmap.BundleAdjustmentConfig()
    for image in model.images.values():
        if image.has_pose:
            config.add_image(image.image_id)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    adjuster = pycolmap.create_default_ceres_bundle_adjuster(pycolmap.BundleAdjustmentOptions(), config, model)
    options = pycolmap.BACovarianceOptions()
    options.params = pycolmap.BACovarianceOptionsParams.ALL
    found = pycolmap.estimate_ba_covariance(options, model, adjuster)
    covariance = found.get_other_params_cov(camera.params) if found is not None else None
    if covariance is None:
        return np.full(len(camera.focal_length_idxs()), np.nan)
    return np.sqrt(np.maximum(np.diag(covariance), 0))


def calibrate(job: dict[str, Any]) -> None:
    """Bundle adjustment of one model with focal length and radial terms free; their values and standard deviations."""
    pycolmap.set_random_seed(job["seed"])
    model = pycolmap.Reconstruction(job["model"])
    options = pycolmap.BundleAdjustmentOptions()
    options.refine_focal_length = options.refine_extra_params = True
    options.refine_principal_point = False
    options.print_summary = False
    options.ceres.loss_function_type = pycolmap.LossFunctionType.CAUCHY
    options.ceres.loss_function_scale = job["loss_px"]
    options.ceres.solver_options.num_threads = REPEATABLE_THREADS
    # COLMAP's default is 0, so that it makes all 100 iterations. Those left out moved the focal length of two films by
    # 1e-5 and 1e-4 of itself, a fortieth of its standard deviation at most.
    options.ceres.solver_options.function_tolerance = LEAST_DECREASE
    pycolmap.bundle_adjustment(model, options)
    camera = camera_of(model)
    found = {"params": [float(p) for p in camera.params], "sigma": [float(s) for s in camera_sigma(model)]}
    Path(job["output"]).write_text(json.dumps(found))


def scale_models(job: dict[str, Any]) -> None:
    """Write each model in another unit: a similarity that only scales."""
    for entry in job["models"]:
        model = pycolmap.Reconstruction(entry["source"])
        model.transform(pycolmap.Sim3d(entry["factor"], pycolmap.Rotation3d(), np.zeros(3)))
        target = Path(entry["target"])
        target.mkdir(parents=True, exist_ok=True)
        model.write_binary(target)


def model_arrays(model: pycolmap.Reconstruction) -> dict[str, NDArray]:
    """A reconstruction as arrays; frames in name order, pixels in COLMAP's convention.

    names (N), world_from_camera (N,4,4), points (P,3), error_px (P), observations (M,2) of frame row and point row,
    pixels (M,2), camera_params.
    """
    images = sorted((i for i in model.images.values() if i.has_pose), key=lambda image: image.name)
    rows = {point_id: row for row, point_id in enumerate(sorted(model.points3D))}
    worlds_from_camera, observations, pixels = [], [], []
    for number, image in enumerate(images):
        world_from_camera = np.eye(4)
        world_from_camera[:3] = image.cam_from_world().inverse().matrix()
        worlds_from_camera.append(world_from_camera)
        for point in image.points2D:
            if point.has_point3D():
                observations.append((number, rows[point.point3D_id]))
                pixels.append(point.xy)
    points = [model.points3D[point_id] for point_id in sorted(model.points3D)]
    camera = camera_of(model)
    return {
        "names": np.array([image.name for image in images]),
        "world_from_camera": np.array(worlds_from_camera).reshape(-1, 4, 4),
        "points": np.array([p.xyz for p in points]).reshape(-1, 3),
        "error_px": np.array([p.error for p in points]),
        "observations": np.array(observations, dtype=np.int64).reshape(-1, 2),
        "pixels": np.array(pixels, dtype=np.float64).reshape(-1, 2),
        "camera_params": np.array(camera.params),
    }


def _batches(items: list) -> list[list]:
    size = max(1, -(-len(items) // BATCHES))
    return [items[i : i + size] for i in range(0, len(items), size)]


def _report(done: int, total: int) -> None:
    print(done, total, flush=True)


def main() -> None:
    action, job_file = sys.argv[1:]
    job = json.loads(Path(job_file).read_text())
    pycolmap.logging.minloglevel = 1
    {"match": extract_and_match, "map": map_scene, "scale": scale_models, "calibrate": calibrate}[action](job)


if __name__ == "__main__":
    main()
