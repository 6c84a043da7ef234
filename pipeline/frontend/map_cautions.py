"""What a user is told of a map that is kept although it may be wrong, and what to try."""

from collections.abc import Iterable

from haustra.core.camera import Camera
from pipeline.config import FrontEndSettings
from pipeline.frontend.odometry.self_calibration import doubt_of_lens
from pipeline.frontend.registry import FIRST, SECOND
from pipeline.frontend.scoring import MAX_INCONSISTENT, MIN_JUDGED, Candidate
from pipeline.mapping.map_doubt import FAMILY
from pipeline.mapping.submap import Submap
from pipeline.run_folder.workspace import Workspace

FEW_POSED = 0.5  # of the usable frames
FEW_PX = 100  # of the shorter side of a picture, in which corners and features are few


def advice_after(front_ends: Iterable[str], workspace: Workspace) -> str:
    """What to try with a doubtful map, after these front ends."""
    untried = [other for other in (FIRST, SECOND) if other not in front_ends]
    return _check_lens(workspace) + (
        f"compare with --front-end {untried[0]}, or use other frames" if untried else "use other frames"
    )


def advice_unrelated(front_ends: Iterable[str], camera: Camera, workspace: Workspace) -> str:
    """What to try where these front ends made no map at all. camera: of the working frames."""
    if min(camera.width, camera.height) < FEW_PX:
        return f"the pictures show {camera.width}x{camera.height} pixels, which hold few features: give larger ones"
    longer = "give a longer part, or one where the camera moves more (--start, --end)"
    other = f", or try --front-end {SECOND}" if FIRST in front_ends and SECOND not in front_ends else ""
    return f"{_check_lens(workspace)}{longer}{other}"


def _check_lens(workspace: Workspace) -> str:
    """Advice that comes before any other, if a user named the lens."""
    return "check that the lens is this film's (--camera), " if _named_lens(workspace) else ""


def few_posed(posed: int, total: int, advice: str) -> list[str]:
    """A sentence on a film most of which is in no map, whatever the rest is worth."""
    return [] if posed >= FEW_POSED * total else [f"only {posed} of {total} usable frames have a pose; {advice}"]


def carried_by_depth(bridged: float) -> list[str]:
    """A sentence on maps that a sensor's depth alone joined, over stretches whose pictures show nothing."""
    if not bridged:
        return []
    places = "one stretch" if bridged == 1 else f"each of {bridged:.0f} stretches"
    return [f"{places} without usable pictures is carried over by the sensor's depth alone; check the wall there first"]


def doubts_of_submaps(candidates: list[Candidate], advice: str) -> list[str]:
    """Sentences on submaps that are kept although they may be wrong, or the lighting check does not speak for them
    where nothing else does."""
    found = []
    for number, one in enumerate(candidates):
        check = one.check
        if check.n_checked == 0:
            found.append(f"submap {number} has too few points in each frame for the lighting check")
        if one.doubt is not None:
            found += [sentence] if (sentence := one.doubt.sentence(number, advice)) else []
        elif check.inconsistent_share > MAX_INCONSISTENT:
            share = 100 * check.inconsistent_share
            found.append(
                f"submap {number} is not to be trusted: the endoscope's lamp makes near wall bright, but in "
                f"{share:.0f} % of {check.n_checked} frames nearer points are darker; {advice}"
            )
        elif number == 0 and one.mapper in FAMILY and check.frames < MIN_JUDGED:
            found.append(
                f"submap 0 has {check.frames} frames, and it takes {MIN_JUDGED} to judge whether a map is right; give "
                "a longer part"
            )
    return found


def doubt_of_named_lens(submap: Submap, camera: Camera, settings: FrontEndSettings, workspace: Workspace) -> list[str]:
    """A sentence on a lens that a user named by --camera, where the film determines another."""
    if not (camera.trusted and camera.lens.in_colmap and _named_lens(workspace)):
        return []
    advice = "without --camera the lens is found from the film"
    if settings.poses.file is not None:  # which may be of any lens
        advice = "give by --camera the lens that these poses were found with"
    submap = submap.without_frames(set(submap.frames) - set(submap.frames[submap.observations[:, 0]]))
    sentence = doubt_of_lens(submap, camera, settings.seed, workspace.log)
    return [f"{sentence}; {advice}"] if sentence else []


def _named_lens(workspace: Workspace) -> bool:
    """Whether a user named the lens by --camera; frames need not come from a film."""
    return bool(workspace.record.get("config", {}).get("camera", "auto") != "auto")
