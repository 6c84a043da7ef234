"""The coefficients that `reconstruct` uses, from the committed records map_doubt.json and map_doubt_colmap.json.

    python -m benchmarks.map_doubt ship

Apart from the measurement, so that measuring a record anew changes nothing that later measurements of one commit run.
"""

import argparse
import json
from typing import Any

from benchmarks.common.record import ROOT
from pipeline.mapping.map_doubt import COEFFICIENTS

RECORDS = {"odometry": "map_doubt.json", "colmap": "map_doubt_colmap.json"}  # by family of maps


def add_arguments(parser: argparse.ArgumentParser) -> None:
    del parser


def measure(arguments: argparse.Namespace) -> None:
    """Write what the pipeline reads."""
    del arguments
    families = {
        family: shipped(json.loads((ROOT / "benchmarks/results" / name).read_text()))
        for family, name in RECORDS.items()
    }
    COEFFICIENTS.write_text(json.dumps(families, indent=2) + "\n")


def shipped(record: dict[str, Any]) -> dict[str, Any]:
    """Coefficients of a record, with its commit and how many maps they were fitted to, how many of them wrong."""
    choosing = [row for row in record["maps"] if row["role"] == "choosing"]
    about = {"commit": record["environment"]["commit"], "maps": len(choosing)}
    return dict(record["coefficients"]) | about | {"wrong": sum(row["wrong"] for row in choosing)}
