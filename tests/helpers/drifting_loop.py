"""A submap on a circle whose scale drifts, and the loops that are true of it."""

from dataclasses import replace
from itertools import pairwise

import numpy as np

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.sim3 import scale_of
from pipeline.config import Config, LoopClosingSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.depth.depth_io import write_confidence, write_depth
from pipeline.depth.keyframe_store import DiskKeyframes
from pipeline.depth.rectification import make_rectifier
from pipeline.loop_closing.detection import LoopClosure, SubmapFeatures
from pipeline.mapping.submap import Submap
from pipeline.matching.keyframe_features import KeyframeFeatures
from pipeline.matching.sim3_match import Sim3Match
from pipeline.run_folder.workspace import Workspace
from tests.helpers.pose_circle import circle, exponential

CAMERA = Camera("PINHOLE", 64, 64, (40.0, 40.0, 32.0, 32.0))
RAYS = RayTable(CAMERA)
GROWTH = 0.004  # of the scale, from keyframe to keyframe
COUNT = 24
CONFIG = Config(camera="given", loop_closing=LoopClosingSettings(enabled=True))


def drifting_submap(count: int = COUNT, growth: float = GROWTH, seed: int = 0) -> Submap:
    """Two frames a keyframe step on a circle; each point is seen by seven frames, in their drifting scale."""
    rng, true = np.random.default_rng(seed), circle(2 * count)
    nodes = [true[0]]
    for here, there in pairwise(true):
        nodes.append(nodes[-1] @ np.linalg.inv(here) @ there @ exponential(growth / 2 * np.eye(7)[6]))
    nodes = np.stack(nodes)
    points, observations = [], []
    for row in range(0, 2 * count - 6, 2):
        local = np.column_stack([rng.uniform(-0.6, 0.6, (40, 2)), rng.uniform(0.8, 1.3, 40)])
        observations += [(frame, len(points) + k) for frame in range(row, row + 7) for k in range(40)]
        points += list(local @ nodes[row + 3, :3, :3].T + nodes[row + 3, :3, 3])
    poses = nodes.copy()
    poses[:, :3, :3] /= scale_of(nodes)[:, None, None]
    return Submap(
        np.arange(2 * count),
        poses,
        np.array(points),
        np.full(len(points), 0.4),
        np.array(observations),
        np.full((len(observations), 2), 30.0),
        CAMERA.params,
    )


def dense(workspace: Workspace, submap: Submap | None = None) -> CompletedSubmap:
    submap = submap or drifting_submap()
    for folder in (workspace.depth, workspace.confidence):
        folder.mkdir(exist_ok=True, parents=True)
    rows = np.arange(0, len(submap.frames), 2)
    for row in rows:
        write_depth(workspace.depth_path(int(submap.frames[row])), np.ones((64, 64), np.float32))
        write_confidence(workspace.confidence_path(int(submap.frames[row])), np.ones((64, 64)))
    return CompletedSubmap(submap, make_rectifier(CAMERA, 120), rows, DiskKeyframes(workspace))


def seen(completed: CompletedSubmap) -> SubmapFeatures:
    return SubmapFeatures(completed, [KeyframeFeatures.none(int(row)) for row in completed.rows], RAYS)


def closure(first: int, second: int, first_from_second: np.ndarray, sigma: np.ndarray) -> LoopClosure:
    return LoopClosure(Sim3Match(first, second, first_from_second, np.zeros((50, 2), np.int64)), np.diag(sigma**-2.0))


def with_relation(loop: LoopClosure, first_from_second: np.ndarray) -> LoopClosure:
    return replace(loop, match=replace(loop.match, first_from_second=first_from_second))


def true_links(pairs: tuple[tuple[int, int], ...] = ((0, 23), (2, 21), (1, 22))) -> list[LoopClosure]:
    """Between keyframes; what the true circle says, in the scale of either end's own axes."""
    true = circle(2 * COUNT)[::2]
    sigma = np.array([0.01] * 3 + [0.01] * 3 + [0.01])
    found = []
    for first, second in pairs:
        relation = np.linalg.inv(true[first]) @ true[second]
        relation[:3, :3] *= np.exp(-GROWTH * (second - first))  # the second's map is larger: brought to the first's
        relation[:3, 3] *= np.exp(GROWTH * first)
        found.append(closure(first, second, relation, sigma))
    return found


def gap(submap: Submap) -> float:
    """Between the end and where the circle says that it is, as seen from the start."""
    true = circle(2 * COUNT)
    return float(np.linalg.norm((submap.centres[46] - submap.centres[0]) - (true[46] - true[0])[:3, 3]))


def rigid(completed: CompletedSubmap, link: LoopClosure) -> np.ndarray:
    first, second = (
        completed.submap.world_from_camera[completed.rows[k]] for k in (link.match.first, link.match.second)
    )
    return np.linalg.inv(first) @ second


def cut(submap: Submap, begin: int, end: int) -> Submap:
    return submap.without_frames({*range(begin), *range(end, 48)})
