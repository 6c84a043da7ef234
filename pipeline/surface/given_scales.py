"""Scales that are known before the surface is: of given poses by their unit, of a sensor or second eye by its depth."""

from itertools import zip_longest

import numpy as np

from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.sensor.sensor_scale import SensorScale, sensor_scale
from pipeline.frontend.structure_stage import scene_unit, scene_units
from pipeline.given_settings import PoseSettings
from pipeline.input.frames import Frames
from pipeline.input.pose_files.pose_table import POSES_UNIT
from pipeline.input.sensor.sensor_depth import open_sensor
from pipeline.input.sensor.usual_distances import check_view, doubt_of_view
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace
from pipeline.surface.scale import SCENE, Scale, checked_against


def given_scales(
    poses: PoseSettings, frames: Frames, submaps: list[CompletedSubmap], workspace: Workspace
) -> tuple[Scale | None, ...]:
    """Scale of each submap, by its number: of a sensor where there is one, else of the unit of given poses, which make
    one submap. Empty where nothing is given."""
    by_poses: tuple[Scale | None, ...] = ()
    if poses.file is not None:
        by_poses = (scale_of_poses(scene_unit(workspace), poses.mm_per_unit, submaps[0].submap),)
    sensor = open_sensor(workspace, frames.camera.width)
    if sensor is None:
        return by_poses
    measured, units = [sensor_scale(one.submap, sensor) for one in submaps], scene_units(workspace)
    by_sensor = [scale_of_sensor(None if one is None else one.in_unit_of(units)) for one in measured]
    checked = [checked_against(one, by_poses) if one is not None else None for one in by_sensor]
    return tuple(one or without_sensor(of_poses) for one, of_poses in zip_longest(checked, by_poses))


def scale_of_poses(unit: float, mm_per_unit: float | None, submap: Submap | None = None) -> Scale:
    """Scale of a submap made from given poses, one scene unit of which is `unit` of theirs; doubted where the wall is
    then at a distance that few endoscopes see it from, and HaustraError where none does."""
    if mm_per_unit is None:
        return Scale(unit, "scene", "the unit of the given poses; give --poses-mm to have mm")
    factor, doubt = unit * mm_per_unit, ""
    depths = np.zeros(0) if submap is None else submap.depths()
    if (depths > 0).any():
        distance = factor * float(np.median(depths[depths > 0]))
        check_view(distance, "poses", POSES_UNIT)
        doubt = doubt_of_view(distance, "poses", POSES_UNIT)
    return Scale(factor, "mm", f"poses that were given: {mm_per_unit:g} mm per unit", doubt)


def scale_of_sensor(found: SensorScale | None) -> Scale | None:
    """Scale of a submap whose depth a sensor measured; None where it saw too little."""
    return None if found is None else Scale(found.mm_per_unit, "mm", str(found), found.doubt, found.clock_doubt)


def without_sensor(otherwise: Scale | None) -> Scale:
    """Scale of a submap of which a sensor saw too little: what is known otherwise, and that the sensor gave nothing."""
    scale = SCENE if otherwise is None else otherwise
    return scale.with_doubt(
        "the sensor saw too few of the map's points: neither its depth nor its millimetres are used"
    )
