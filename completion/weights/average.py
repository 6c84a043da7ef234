"""Average of two weight files of one network, of which the second was trained on from the first.

    python -m completion.weights.average FIRST SECOND OUT --share 0.65

Between a network and its fine-tuned self the error hardly rises, and what either was trained for is kept (Wortsman et
al., "Robust fine-tuning of zero-shot models", CVPR 2022). Running statistics of normalisations are averaged too.
"""

import argparse
import hashlib
from pathlib import Path
from typing import Any

from completion.networks.checkpoint import load_network, read_metadata, save_network
from haustra.core.errors import CompletionError


def average_weights(first: Path, second: Path, share: float, out: Path) -> Path:
    """Write (1 - share) x the first's + share x the second's weights; the header tells of both. CompletionError if they
    are of different networks."""
    if not 0 <= share <= 1:
        raise CompletionError(f"the second's share must lie between 0 and 1, not {share:g}")
    one, other = load_network(first), load_network(second)
    if type(one) is not type(other) or one.config != other.config:
        raise CompletionError(f"{first} and {second} hold different networks: nothing to average")
    theirs = other.state_dict()
    mixed = {
        name: tensor.lerp(theirs[name], share) if tensor.is_floating_point() else theirs[name]
        for name, tensor in one.state_dict().items()
    }
    metadata = read_metadata(second)
    about: dict[str, Any] = {
        name: metadata[name] for name in ("steps", "seed", "unit_mm", "training") if name in metadata
    }
    about["averaged"] = {"with_sha256": hashlib.sha256(first.read_bytes()).hexdigest(), "share": share}
    save_network(out, other, mixed, about)
    return out


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("first", type=Path)
    parser.add_argument("second", type=Path)
    parser.add_argument("out", type=Path)
    parser.add_argument("--share", type=float, default=0.5, help="of the second")
    arguments = parser.parse_args()
    print(average_weights(arguments.first, arguments.second, arguments.share, arguments.out))


if __name__ == "__main__":
    main()
