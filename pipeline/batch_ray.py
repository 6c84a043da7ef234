"""The same batch on a Ray cluster: needs the extra `[cluster]`, haustra on every node, and a shared file system."""

from collections.abc import Iterator

from pipeline.batch import Job, Pool, run_job
from pipeline.batch_table import Outcome
from pipeline.errors import HaustraError

LOCAL = "local"  # a cluster of this machine alone, started for this call
CPUS = 2  # that a reconstruction is counted as


def ray_pool(address: str, workers: int) -> Pool:
    """One task a video on the cluster at `address`; `workers` is the number of CPUs that a local one may count on."""
    try:
        import ray
    except ImportError as error:
        raise HaustraError("--ray needs Ray: pip install 'haustra[cluster]'") from error

    def pool(jobs: list[Job], words: list[str]) -> Iterator[Outcome]:
        if address == LOCAL:
            ray.init(num_cpus=CPUS * workers, include_dashboard=False, log_to_driver=False, configure_logging=False)
        else:
            try:
                ray.init(address=address, log_to_driver=False)
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise HaustraError(f"there is no Ray cluster at {address}: {error}") from error
        # max_retries: a reconstruction that took its node down would do so again.
        task = ray.remote(num_cpus=CPUS, max_retries=0)(run_job)
        job_of = {task.remote(job, words): job for job in jobs}
        waiting = list(job_of)
        try:
            while waiting:
                ready, waiting = ray.wait(waiting)
                for reference in ready:
                    yield _outcome(ray, reference, job_of[reference])
        finally:
            for reference in waiting:
                ray.cancel(reference)  # an interrupt there: the reconstruction stops and keeps what is done
            if waiting:
                ray.wait(waiting, num_returns=len(waiting), timeout=30)
            ray.shutdown()

    return pool


def _outcome(ray, reference, job: Job) -> Outcome:  # type: ignore[no-untyped-def] # Ray is an extra
    try:
        outcome: Outcome = ray.get(reference)
        return outcome
    except ray.exceptions.RayError as error:  # the worker or its node died
        reason = str(error).splitlines()[0]
        return Outcome(str(job.video), str(job.folder), "failed", message=f"its Ray task died: {reason}")
