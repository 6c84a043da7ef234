"""The probability that a submap is wrong: a logistic regression on figures of the submap itself, without truth.

Wrong is a map whose camera centres are off by more than 5 % of the path (RMS) or whose cameras by more than 5 degrees
(median), after the Sim(3) to the truth that fits centres and axes together (`readjustment.path_difference`). The
coefficients, of odometry's maps and of COLMAP's, lie beside this file. They are fitted to films with truth by
`benchmarks/map_doubt`; docs/lab/map_doubt.md has the calibration and how to fit them anew.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import asdict, dataclass
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from haustra.core.camera import Camera
from pipeline.mapping.lighting_check import LightingCheck
from pipeline.mapping.readjustment import PathDifference, by_halves_of_the_wall, by_stretches
from pipeline.mapping.submap import Submap

COEFFICIENTS = Path(__file__).with_name("map_doubt.json")
FAMILY = {"odometry": "odometry", "global": "colmap", "incremental": "colmap"}  # of maps, by mapper
WRONG_SHARE, WRONG_DEG = 0.05, 5.0  # of the path, RMS; of the cameras, median
SURE, PROBABLE = 0.05, 0.5
UNKNOWN = PathDifference(0.05, 5.0)  # of a map too short to be adjusted in parts: nothing speaks for it
LEAST_SHARE, LEAST_DEG = 1e-4, 1e-2


@dataclass(frozen=True)
class MapEvidence:
    """Figures of a submap. reprojection_px: mean. angle_deg: median triangulation angle. track_length: mean number of
    frames that saw a point. path: its length in median depths. spearman, inconsistent_share: as in `LightingCheck`.
    posed_share: of the film's working frames that it holds. submaps: how many the film came apart into. stretches:
    by how much two thirds of it alone differ from the whole; halves: the paths by two halves of the wall."""

    reprojection_px: float
    angle_deg: float
    track_length: float
    path: float
    spearman: float
    inconsistent_share: float
    posed_share: float
    submaps: int
    stretches: PathDifference | None
    halves: PathDifference | None


@dataclass(frozen=True)
class Predictor:
    """An input of the regression. of: its value, which grows where a map is wrong. in_words: the same for a person."""

    of: Callable[[MapEvidence], float]
    in_words: Callable[[MapEvidence], str]


def _log_share(difference: PathDifference | None) -> float:
    return math.log(max((difference or UNKNOWN).share, LEAST_SHARE))


def _log_angle(difference: PathDifference | None) -> float:
    return math.log(max((difference or UNKNOWN).angle_deg, LEAST_DEG))


def _difference_in_words(difference: PathDifference | None, what: str) -> str:
    if difference is None:
        return f"too little of it is seen to compare {what}"
    return f"{what} differ by {100 * difference.share:.1f} % of the path and {difference.angle_deg:.1f} degrees"


def _stretches_in_words(e: MapEvidence) -> str:
    return _difference_in_words(e.stretches, "the paths by the whole and by two thirds of its frames")


def _halves_in_words(e: MapEvidence) -> str:
    return _difference_in_words(e.halves, "the paths by two halves of the wall")


PREDICTORS: dict[str, Predictor] = {
    "stretches, path": Predictor(lambda e: _log_share(e.stretches), _stretches_in_words),
    "stretches, angle": Predictor(lambda e: _log_angle(e.stretches), _stretches_in_words),
    "halves, path": Predictor(lambda e: _log_share(e.halves), _halves_in_words),
    "halves, angle": Predictor(lambda e: _log_angle(e.halves), _halves_in_words),
    "reprojection": Predictor(
        lambda e: math.log(max(e.reprojection_px, 0.01)),
        lambda e: f"its points lie {e.reprojection_px:.2f} px beside where they were seen",
    ),
    "triangulation angle": Predictor(
        lambda e: -math.log(max(e.angle_deg, 0.05)),
        lambda e: f"its points are seen from directions that differ by {e.angle_deg:.1f} degrees",
    ),
    "track length": Predictor(
        lambda e: -math.log(max(e.track_length, 1.0)),
        lambda e: f"its points are followed over {e.track_length:.0f} frames",
    ),
    "path": Predictor(
        lambda e: -math.log(max(e.path, 0.01)),
        lambda e: f"its camera moves by {e.path:.1f} times the distance of the wall",
    ),
    "light": Predictor(
        lambda e: e.spearman,
        lambda e: (
            f"brightness falls with distance less clearly than in most right maps (rank correlation {e.spearman:.2f}, "
            "-1 at best)"
        ),
    ),
    "light against it": Predictor(
        lambda e: min(e.inconsistent_share, 0.3),
        lambda e: f"in {100 * e.inconsistent_share:.0f} % of its frames nearer points are darker",
    ),
    "frames posed": Predictor(
        lambda e: -e.posed_share,
        lambda e: f"it holds {100 * e.posed_share:.0f} % of the frames",
    ),
    "submaps": Predictor(
        lambda e: float(min(e.submaps, 5)),
        lambda e: f"the film came apart into {e.submaps} submaps",
    ),
}


@dataclass(frozen=True)
class MapDoubt:
    """probability: that the map is wrong. heaviest: in words, the predictor that raises it most over a right map's."""

    probability: float
    heaviest: str
    evidence: MapEvidence

    def to_dict(self) -> dict[str, Any]:
        """For run.yaml and metrics.json."""
        return {"probability": self.probability, "heaviest": self.heaviest, "evidence": asdict(self.evidence)}

    def sentence(self, number: int, advice: str) -> str | None:
        """For a person; None where there is no doubt worth a word."""
        if self.probability < SURE:
            return None
        verdict = "is probably" if self.probability >= PROBABLE else "may be"
        how_far = "is not to be trusted" if self.probability >= PROBABLE else "is to be trusted with care"
        return (
            f"submap {number} {verdict} wrong (probability {100 * self.probability:.0f} %) and {how_far}: "
            f"{self.heaviest}; {advice}"
        )


def gather_evidence(
    submap: Submap,
    camera: Camera,
    check: LightingCheck,
    total: int,
    submaps: int,
    *,
    predictors: Iterable[str] = PREDICTORS,
) -> MapEvidence:
    """Evidence on one of `submaps` found in `total` working frames; camera: as refined with it. predictors: names of
    those that will be used. Parts of the map are adjusted alone, which takes long, only where one needs that."""
    kinds = {name.split(",")[0] for name in predictors}
    depths = submap.depths()
    unit = float(np.median(depths[depths > 0])) if (depths > 0).any() else 1.0
    one = submap.scaled(1 / unit)
    return MapEvidence(
        check.reprojection_px,
        check.angle_deg,
        float(one.track_lengths().mean()) if len(one.points) else 0.0,
        float(np.linalg.norm(np.diff(one.centres, axis=0), axis=1).sum()),
        check.spearman,
        check.inconsistent_share,
        len(one.frames) / max(total, 1),
        submaps,
        by_stretches(one, camera) if "stretches" in kinds else None,
        by_halves_of_the_wall(one, camera) if "halves" in kinds else None,
    )


def judge(evidence: MapEvidence, family: str) -> MapDoubt:
    """The probability by the shipped coefficients of a family of maps, and its main reason."""
    fitted = coefficients()[family]
    weights, of_right_maps = fitted["weights"], fitted["of_right_maps"]
    values = {name: PREDICTORS[name].of(evidence) for name in weights}
    heaviest = max(weights, key=lambda name: weights[name] * (values[name] - of_right_maps[name]))
    z = max(min(log_odds(values, fitted), 30.0), -30.0)
    return MapDoubt(1 / (1 + math.exp(-z)), PREDICTORS[heaviest].in_words(evidence), evidence)


def log_odds(values: Mapping[str, float], fitted: Mapping[str, Any]) -> float:
    """Log odds that a map is wrong. values: of the predictors, by name; fitted: one family of `coefficients`."""
    return float(fitted["offset"] + sum(weight * values[name] for name, weight in fitted["weights"].items()))


@cache
def coefficients() -> dict[str, Any]:
    """Of each family: `offset`, `weights` by the predictors' names, and these predictors' medians `of_right_maps`;
    fitted by `python -m benchmarks.map_doubt fit`, written by `python -m benchmarks.map_doubt ship`."""
    found: dict[str, Any] = json.loads(COEFFICIENTS.read_text())
    return found
