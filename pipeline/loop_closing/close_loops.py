"""Stage 4: loop closing. Poses, sparse points and the scale of the depths follow together.

Submaps that show the same places are merged, and each then closes its own loops. Without an accepted loop nothing is
touched, to the last bit. What moved is written beside what the structure stage made, never over it.
"""

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial import QhullError

from haustra.core.errors import ReconstructionError
from haustra.core.progress import Progress
from pipeline.config import LoopClosingSettings
from pipeline.depth.completed_submap import CompletedSubmap
from pipeline.frontend.points_stage import STAGE as POINTS
from pipeline.frontend.points_stage import points_folder
from pipeline.frontend.structure_stage import closes_loops
from pipeline.input.frames import Frames
from pipeline.loop_closing.detection import (
    SubmapFeatures,
    find_features,
    loop_candidates,
    may_have_loops,
    merge_candidates,
    verify_loops,
)
from pipeline.loop_closing.keyframe_pose_graph import close_loops, merge_by_loops
from pipeline.loop_closing.loop_adjustment import adjust_loops
from pipeline.mapping.colmap_io import write_model
from pipeline.mapping.submap import read_submap, refined_camera
from pipeline.matching.place_recognition import VisualWords
from pipeline.run_folder.workspace import Workspace, report_corruption

STAGE = "refinement"  # the stage's name in run.yaml since version 0.1; nothing but loop closing is meant
FAILURES = (np.linalg.LinAlgError, QhullError, ReconstructionError)  # of geometry, not of files
NOT_ADJUSTED = "too few features hold its keyframes together, or the adjusted map meets its loops no better"


@dataclass
class _Piece:
    """A submap while submaps are merged and its loops are closed."""

    completed: CompletedSubmap
    members: list[int]  # numbers of the depth stage's submaps that it was merged from
    seen: SubmapFeatures
    candidates: int = 0  # loops that were verified geometrically
    consistent: int = 0  # of these, those that another loop confirms
    loops: list[tuple[int, int]] = field(default_factory=list)  # accepted; frame numbers


def close_loops_stage(
    frames: Frames,
    submaps: list[CompletedSubmap],
    settings: LoopClosingSettings,
    seed: int,
    workspace: Workspace,
    progress: Progress,
) -> list[CompletedSubmap]:
    """The submaps merged and with their loops closed; what fails stays as it was, with a warning.

    Submaps of a front end that closes loops itself are left alone. So is a run from before this stage whose surface is
    done, since its mesh belongs to its poses.
    """
    done = workspace.is_done(STAGE) or workspace.is_done("surface")
    if not done and settings.enabled and not closes_loops(workspace):
        _merge_and_close(frames, submaps, settings, seed, workspace, progress)
    return load_loops_closed(submaps, workspace)


def _merge_and_close(
    frames: Frames,
    submaps: list[CompletedSubmap],
    settings: LoopClosingSettings,
    seed: int,
    workspace: Workspace,
    progress: Progress,
) -> None:
    warnings: list[str] = []
    if len(submaps) == 1 and not may_have_loops(submaps[0], settings.max_keyframes):
        workspace.finish(STAGE, submaps=[_entry([0], False, 0, 0, [])], warnings=warnings)
        return
    with progress.bar("loop detection", len(submaps)) as advance:
        pieces = []
        for number, submap in enumerate(submaps):
            pieces.append(_Piece(submap, [number], find_features(submap, settings.max_keyframes)))
            advance(number + 1)
    words = VisualWords.of([features for piece in pieces for features in piece.seen.features], seed)
    if settings.merge_submaps:
        pieces = _merged(pieces, settings, words, seed, warnings)
        pieces.sort(key=lambda piece: -len(piece.completed.submap.frames))  # those that are as large stay in order
    for piece in pieces:
        _close(piece, words, seed, warnings)
    records = [_record(number, piece, frames, workspace) for number, piece in enumerate(pieces)]
    moved = [piece for piece, record in zip(pieces, records, strict=True) if record["moved"]]
    for sentence in (*map(_sentence, moved), *warnings):
        progress.log(sentence)
    workspace.finish(STAGE, submaps=records, warnings=warnings)


def load_loops_closed(submaps: list[CompletedSubmap], workspace: Workspace) -> list[CompletedSubmap]:
    """What a finished stage made of the depth stage's submaps; those themselves where it did not run."""
    if not workspace.is_done(STAGE):
        return submaps
    records = workspace.result(STAGE)["submaps"]
    return [_loaded(number, submaps, record, workspace) for number, record in enumerate(records)]


def first_parts(workspace: Workspace, count: int) -> list[int]:
    """Of each of `count` submaps after this stage, the number that its first member had before."""
    if not workspace.is_done(STAGE):
        return list(range(count))
    return [record["members"][0] for record in workspace.result(STAGE)["submaps"]]


def model_sources(workspace: Workspace) -> list[tuple[Path, float]]:
    """For each submap after this stage: the folder of its model, and one scene unit in the model's unit."""
    before = [(workspace.models / str(k), unit) for k, unit in enumerate(workspace.result("structure")["units"])]
    if workspace.is_done(POINTS):
        before = [(points_folder(workspace) / str(number), 1.0) for number in range(len(before))]
    if not workspace.is_done(STAGE):
        return before
    return [
        (_folder(workspace, number), 1.0) if record["moved"] else before[record["members"][0]]
        for number, record in enumerate(workspace.result(STAGE)["submaps"])
    ]


def _merged(
    pieces: list[_Piece], settings: LoopClosingSettings, words: VisualWords, seed: int, warnings: list[str]
) -> list[_Piece]:
    """Each piece grown by those that surely show the same places; a grown one is compared anew."""
    left, done = list(pieces), []
    while left:
        base, number = left.pop(0), 0
        while number < len(left):
            grown = _merge(base, left[number], settings, words, seed, warnings)
            if grown is None:
                number += 1
                continue
            base, number = grown, 0
            left = [piece for piece in left if not set(piece.members) & set(grown.members)]
        done.append(base)
    return done


def _merge(
    base: _Piece, other: _Piece, settings: LoopClosingSettings, words: VisualWords, seed: int, warnings: list[str]
) -> _Piece | None:
    seen = base.seen, other.seen
    if min(len(base.completed), len(other.completed)) == 0:
        return None
    try:
        pairs = merge_candidates(*seen, words)
        completed = merge_by_loops(seen, verify_loops(*seen, pairs, seed))
    except FAILURES as error:
        warnings.append(f"submaps {base.members[0]} and {other.members[0]} were not merged: {error}")
        return None
    if completed is None:
        return None
    return _Piece(completed, base.members + other.members, find_features(completed, settings.max_keyframes))


def _close(piece: _Piece, words: VisualWords, seed: int, warnings: list[str]) -> None:
    if len(piece.completed) < 2:
        return
    try:
        pairs = loop_candidates(piece.seen, words)
        closed = close_loops(piece.seen, verify_loops(piece.seen, piece.seen, pairs, seed))
        piece.candidates, piece.consistent = closed.candidates, closed.consistent
        adjusted = adjust_loops(piece.seen, closed) if closed.accepted_pairs else piece.completed
    except FAILURES as error:
        warnings.append(f"the loops of submap {piece.members[0]} were not closed: {error}")
        return
    if adjusted is None and closed.completed is piece.completed:
        return  # the map misses its loops by no more than they can tell
    if adjusted is None:
        warnings.append(f"the loops of submap {piece.members[0]} were not closed: {NOT_ADJUSTED}")
        return
    piece.completed, piece.loops = adjusted, list(closed.accepted_pairs)


def _record(number: int, piece: _Piece, frames: Frames, workspace: Workspace) -> dict[str, Any]:
    """Write a piece that moved, and say what it is; `loops` are pairs of frame numbers."""
    completed, moved = piece.completed, piece.completed.depth_scale is not None
    if moved:
        folder = _folder(workspace, number)
        write_model(completed.submap, refined_camera(frames.camera, completed.submap), folder)
        np.savez(folder / "depth_scale.npz", rows=completed.rows, depth_scale=np.asarray(completed.depth_scale))
    return _entry(piece.members, moved, piece.candidates, piece.consistent, piece.loops)


def _entry(
    members: list[int], moved: bool, proposed: int, supported: int, loops: list[tuple[int, int]]
) -> dict[str, Any]:
    """Of a submap in the stage's record."""
    pairs = [list(pair) for pair in loops]
    return {"members": members, "moved": moved, "proposed": proposed, "supported": supported, "loops": pairs}


def _loaded(
    number: int, submaps: list[CompletedSubmap], record: dict[str, Any], workspace: Workspace
) -> CompletedSubmap:
    completed = submaps[record["members"][0]]
    if not record["moved"]:
        return completed
    folder = _folder(workspace, number)
    with report_corruption(folder), np.load(folder / "depth_scale.npz", allow_pickle=False) as arrays:
        submap = replace(read_submap(folder), camera_sigma=completed.submap.camera_sigma)
        return replace(completed, submap=submap, rows=arrays["rows"], depth_scale=arrays["depth_scale"])


def _folder(workspace: Workspace, number: int) -> Path:
    return workspace.log / "refined" / str(number)


def _sentence(piece: _Piece) -> str:
    scale = np.asarray(piece.completed.depth_scale)
    name = f"submap {piece.members[0]}"
    if len(piece.members) > 1:
        name = "submaps " + ", ".join(str(member) for member in piece.members) + " merged"
    return f"{name}: {len(piece.loops)} loops closed, scale from {scale.min():.3f} to {scale.max():.3f}"
