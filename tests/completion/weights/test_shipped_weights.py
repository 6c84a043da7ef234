"""The shipped weights are whole, and a file that is cut off is told by its header."""

import numpy as np
import pytest
from safetensors.numpy import save_file

from completion.weights.shipped_weights import SHIPPED_WEIGHTS, check_whole, resolve_weights
from haustra.core.errors import CompletionError


@pytest.mark.parametrize("name", SHIPPED_WEIGHTS)
def test_the_shipped_ones_are_whole(name: str) -> None:
    check_whole(resolve_weights(name))


@pytest.mark.parametrize("left", [0, 5, 40, 300])
def test_a_file_that_is_cut_off_is_refused(tmp_path, left: int) -> None:
    path = tmp_path / "weights.safetensors"
    save_file({"a": np.ones((8, 8), np.float32), "b": np.zeros(7)}, path, metadata={"about": "nothing"})
    check_whole(path)
    path.write_bytes(path.read_bytes()[:left])
    with pytest.raises(CompletionError, match="install haustra again"):
        check_whole(path)
