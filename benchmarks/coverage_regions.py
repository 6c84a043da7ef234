"""How likely a reported region is hidden wall: fitted on the films that coverage was chosen on, tried on the others.

    python -m benchmarks.coverage_regions benchmarks/results/coverage.json

Log odds = offset + slope log(reach in lumen radii), by maximum likelihood on the regions over 5 mm of runs on films of
`role` chosen; what it prints is OFFSET and SLOPE of `reconstruction/coverage/missed_regions.py`, and their standard
errors by the curvature of the likelihood. Log loss in nats a region, beside that of always saying the share of true
regions.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize
from scipy.special import expit

from benchmarks.common.runner import run
from benchmarks.coverage import RECONSTRUCT, ROLES

Array = NDArray[np.float64]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("record", type=Path, help="of `python -m benchmarks.coverage`")


def measure(arguments: argparse.Namespace) -> None:
    record = json.loads(arguments.record.read_text())
    coefficients, sigma = fitted(*regions_of(record, "chosen"))
    print(f"offset {coefficients[0]:.2f} +- {sigma[0]:.2f}, slope {coefficients[1]:.2f} +- {sigma[1]:.2f}")
    for role in ROLES:
        reach, is_true = regions_of(record, role)
        told = expit(coefficients[0] + coefficients[1] * np.log(reach))
        share = np.full(len(reach), is_true.mean())
        print(
            f"{role}: {len(reach)} regions, loss {loss(told, is_true):.3f}; by their share {loss(share, is_true):.3f}"
        )


def regions_of(record: dict[str, Any], role: str) -> tuple[Array, NDArray[np.bool_]]:
    """Reach (N,) in lumen radii of what runs reported on the films of a role, and whether it was true (N,)."""
    rows = [row for row in record["runs"] if row["method"] == RECONSTRUCT and row["role"] == role]
    regions = [region for row in rows for region in row.get("regions", [])]
    return np.array([r["reach_radii"] for r in regions]), np.array([r["is_true"] for r in regions], bool)


def fitted(reach: Array, is_true: NDArray[np.bool_]) -> tuple[Array, Array]:
    """Offset and slope (2,), and their standard errors (2,)."""
    rows = np.stack([np.ones(len(reach)), np.log(reach)], axis=1)
    found = minimize(lambda told: loss(expit(rows @ told), is_true), np.zeros(2), options={"gtol": 1e-8}).x
    likelihood = expit(rows @ found)
    information = rows.T @ (rows * (likelihood * (1 - likelihood))[:, None])
    return np.asarray(found), np.sqrt(np.diag(np.linalg.inv(information)))


def loss(probability: Array, is_true: NDArray[np.bool_]) -> float:
    """Mean negative log likelihood."""
    said = np.clip(np.where(is_true, probability, 1 - probability), 1e-12, None)
    return float(-np.log(said).mean())


if __name__ == "__main__":
    run(sys.modules[__name__], "benchmarks.coverage_regions")
