"""A Ray cluster to work on: needs the extra `[cluster]`, haustra on every node, and a shared file system."""

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from haustra.core.errors import HaustraError

LOCAL = "local"  # a cluster of this machine alone, started for this call


def import_ray() -> Any:
    """Ray, or a sentence on how to get it."""
    try:
        import ray
    except ImportError as error:
        raise HaustraError("--ray needs Ray: pip install 'haustra[cluster]'") from error
    return ray


@contextmanager
def connected(address: str, cpus: int) -> Iterator[Any]:
    """Ray, connected to the cluster at `address`; `cpus` is the number that a local one may count on."""
    ray = import_ray()
    if address == LOCAL:
        ray.init(num_cpus=cpus, include_dashboard=False, log_to_driver=False, configure_logging=False)
    else:
        try:
            ray.init(address=address, log_to_driver=False)
        except (ConnectionError, ValueError, RuntimeError) as error:
            raise HaustraError(f"there is no Ray cluster at {address}: {error}") from error
    try:
        yield ray
    finally:
        ray.shutdown()


def stop(ray: Any, waiting: list[Any]) -> None:
    """End tasks as an interrupt would, and give them time for it."""
    for reference in waiting:
        ray.cancel(reference)
    if waiting:
        ray.wait(waiting, num_returns=len(waiting), timeout=30)
