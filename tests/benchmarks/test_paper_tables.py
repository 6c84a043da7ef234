"""The benchmark of the paper's tables: its rows, its cells, and that figures of other frames are not reused."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from benchmarks import paper_tables
from benchmarks.paper_tables import ROWS, cell, chosen_rows, digest, table
from completion.networks.registry import REGISTRY


def test_every_row_is_a_network_and_only_the_named_ones_are_asked_for() -> None:
    for number, rows in ROWS.items():
        assert set(rows.values()) <= set(REGISTRY)
        assert chosen_rows(number, None).keys() == rows.keys() - paper_tables.ONLY_NAMED
    named = ["full, residual, SA of like channels", "baseline"]
    assert list(chosen_rows(2, named).values()) == ["unet", "mscsa+residual+similar"]
    with pytest.raises(SystemExit, match="no row msc in Table 2"):
        chosen_rows(2, ["msc"])


def test_cells_are_means_over_seeds_with_half_their_spread() -> None:
    figures = [
        {"folder": "colon", "model": "unet", "frames": 7, "seed": seed}
        | dict.fromkeys(paper_tables.FIGURES, 1.0)
        | {"abs_rel": abs_rel}
        for seed, abs_rel in enumerate((0.08, 0.06))
    ]
    assert cell(figures, "abs_rel") == "7.0000 +-1.000"
    assert cell(figures[:1], "rmse") == "1.0000"
    text = table("colon", {"baseline": "unet"}, figures)
    assert "7 frames of meshes never trained on" in text
    assert "7.0000 +-1.000" in text


def test_other_frames_have_another_name(tmp_path: Path) -> None:
    names = set()
    for number, (about, depth) in enumerate(((1, 5), (2, 5), (1, 6), (1, 5))):
        folder = tmp_path / str(number)
        folder.mkdir()
        (folder / "shards.json").write_text(json.dumps({"frames": 2, "seed": about}))
        for name, shape in (("depths", (2, 4, 4)), ("images", (2, 4, 4, 3)), ("colon", (2,))):
            np.save(folder / f"{name}.npy", np.full(shape, depth, np.float16 if name == "depths" else np.uint8))
        names.add(digest([folder]))
    assert len(names) == 3
