"""Stage 3b: places seen twice close the path; poses, sparse points and the scale of the depths follow together.

Submaps that show the same places become one, and each then closes its own loops. Without a loop that can be believed
nothing is touched, to the last bit. What moved is written beside what the structure stage made, never over it.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import QhullError

from haustra.core.progress import Progress
from pipeline.config import Config
from pipeline.depth.completion_stage import DenseSubmap
from pipeline.frontend.structure_stage import closes_loops
from pipeline.input.frames import Frames
from pipeline.loop_closing.detection import (
    SubmapFeatures,
    find_features,
    loop_candidates,
    merge_candidates,
    verify_loops,
)
from pipeline.loop_closing.keyframe_pose_graph import close_loops, merge
from pipeline.loop_closing.loop_adjustment import adjust_loops
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import read_submap, refined_camera
from pipeline.run_folder.workspace import Workspace, damage_named

FAILURES = (np.linalg.LinAlgError, QhullError, ValueError)
UNHELD = "too few features hold its keyframes together"


@dataclass
class _Piece:
    """A submap on its way: what it was made of, and what became of its loops."""

    part: DenseSubmap
    members: list[int]
    seen: SubmapFeatures
    proposed: int = 0
    supported: int = 0
    loops: list[tuple[int, int]] = field(default_factory=list)


def refine_poses(
    frames: Frames, dense: list[DenseSubmap], config: Config, workspace: Workspace, progress: Progress
) -> list[DenseSubmap]:
    """The submaps joined and with their loops closed; what fails stays as it was, with a warning.

    COLMAP's maps are left alone: it matches far frames itself and adjusts all of them. So is a run from before this
    stage whose surface is done, since its mesh belongs to its poses.
    """
    done = workspace.is_done("refinement") or workspace.is_done("surface")
    if done or not config.loop_closing.enabled or closes_loops(workspace):
        return refined_keyframes(dense, workspace)
    warnings: list[str] = []
    with progress.bar("places seen twice", len(dense)) as advance:
        pieces = []
        for number, part in enumerate(dense):
            pieces.append(_Piece(part, [number], find_features(part, frames, config.loop_closing.max_keyframes)))
            advance(number + 1)
    if config.loop_closing.merge_submaps:
        pieces = _joined(frames, pieces, config, warnings)
    for piece in pieces:
        _close(piece, frames, config, warnings)
    records = [_record(number, piece, frames, workspace) for number, piece in enumerate(pieces)]
    for piece, before in zip(pieces, records, strict=True):
        if before["moved"]:
            progress.say(_sentence(piece))
    for sentence in warnings:
        progress.say(sentence)
    workspace.finish("refinement", submaps=records, warnings=warnings)
    return refined_keyframes(dense, workspace)


def refined_keyframes(dense: list[DenseSubmap], workspace: Workspace) -> list[DenseSubmap]:
    """What a finished stage made of the depth stage's submaps; those themselves where it did not run."""
    if not workspace.is_done("refinement"):
        return dense
    records = workspace.result("refinement")["submaps"]
    return [_loaded(number, dense, record, workspace) for number, record in enumerate(records)]


def model_sources(workspace: Workspace) -> list[tuple[Path, float]]:
    """For each submap as refined: the folder of its COLMAP model, and one scene unit in the model's unit."""
    units = workspace.result("structure")["units"]
    if not workspace.is_done("refinement"):
        return [(workspace.models / str(number), unit) for number, unit in enumerate(units)]
    return [
        (_folder(workspace, number), 1.0)
        if record["moved"]
        else (workspace.models / str(record["members"][0]), units[record["members"][0]])
        for number, record in enumerate(workspace.result("refinement")["submaps"])
    ]


def _joined(frames: Frames, pieces: list[_Piece], config: Config, warnings: list[str]) -> list[_Piece]:
    """Each piece grown by those that surely show the same places; a grown one is compared anew."""
    left, done = list(pieces), []
    while left:
        base, number = left.pop(0), 0
        while number < len(left):
            grown = _join(frames, base, left[number], config, warnings)
            if grown is None:
                number += 1
                continue
            base, number = grown, 0
            left = [piece for piece in left if not set(piece.members) & set(grown.members)]
        done.append(base)
    return done


def _join(frames: Frames, base: _Piece, other: _Piece, config: Config, warnings: list[str]) -> _Piece | None:
    seen = base.seen, other.seen
    if min(len(base.part), len(other.part)) == 0:
        return None
    try:
        pairs = merge_candidates(*seen, config.seed)
        part = merge(seen, verify_loops(*seen, pairs, config.seed))
    except FAILURES as error:
        warnings.append(f"submaps {base.members[0]} and {other.members[0]} were not joined: {error}")
        return None
    if part is None:
        return None
    return _Piece(part, base.members + other.members, find_features(part, frames, config.loop_closing.max_keyframes))


def _close(piece: _Piece, frames: Frames, config: Config, warnings: list[str]) -> None:
    if len(piece.part) < 2:
        return
    try:
        pairs = loop_candidates(piece.seen, config.seed)
        closed = close_loops(piece.seen, verify_loops(piece.seen, piece.seen, pairs, config.seed))
        piece.proposed, piece.supported = closed.proposed, closed.supported
        adjusted = adjust_loops(piece.seen, closed, frames) if closed.kept else piece.part
    except FAILURES as error:
        warnings.append(f"the loops of submap {piece.members[0]} were not closed: {error}")
        return
    if adjusted is None and closed.part is piece.part:
        return  # the map misses its loops by no more than they can tell
    if adjusted is None:
        warnings.append(f"the loops of submap {piece.members[0]} were not closed: {UNHELD}")
        return
    piece.part, piece.loops = adjusted, list(closed.kept)


def _record(number: int, piece: _Piece, frames: Frames, workspace: Workspace) -> dict[str, Any]:
    """Write a piece that moved, and say what it is; `loops` are pairs of frame numbers."""
    part, moved = piece.part, piece.part.depth_scale is not None
    if moved:
        folder = _folder(workspace, number)
        write_model(part.submap, refined_camera(frames.camera, part.submap), folder)
        np.savez(folder / "depth_scale.npz", rows=part.rows, depth_scale=np.asarray(part.depth_scale))
    return {
        "members": piece.members,
        "moved": moved,
        "proposed": piece.proposed,
        "supported": piece.supported,
        "loops": [list(pair) for pair in piece.loops],
    }


def _loaded(number: int, dense: list[DenseSubmap], record: dict[str, Any], workspace: Workspace) -> DenseSubmap:
    part = dense[record["members"][0]]
    if not record["moved"]:
        return part
    folder = _folder(workspace, number)
    with damage_named(folder), np.load(folder / "depth_scale.npz", allow_pickle=False) as arrays:
        submap = replace(read_submap(folder), camera_sigma=part.submap.camera_sigma)
        return replace(part, submap=submap, rows=arrays["rows"], depth_scale=arrays["depth_scale"])


def _folder(workspace: Workspace, number: int) -> Path:
    return workspace.log / "refined" / str(number)


def _sentence(piece: _Piece) -> str:
    scale = np.asarray(piece.part.depth_scale)
    name = f"submap {piece.members[0]}"
    if len(piece.members) > 1:
        name = "submaps " + ", ".join(str(member) for member in piece.members) + " joined"
    return f"{name}: {len(piece.loops)} loops closed, scale from {scale.min():.3f} to {scale.max():.3f}"
