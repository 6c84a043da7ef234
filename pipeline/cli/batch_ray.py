"""The same batch on a Ray cluster."""

from collections.abc import Iterator

from pipeline.cli.batch import Job, Pool, run_job
from pipeline.cli.batch_table import Outcome
from pipeline.run_folder.ray_cluster import connected, import_ray, stop

CPUS = 2  # that a reconstruction is counted as


def ray_pool(address: str, workers: int) -> Pool:
    """One task a video on the cluster at `address`; `workers` is the number of CPUs that a local one may count on."""
    import_ray()  # says at once if it is missing

    def pool(jobs: list[Job], arguments: list[str]) -> Iterator[Outcome]:
        with connected(address, CPUS * workers) as ray:
            # max_retries: a reconstruction that took its node down would do so again.
            task = ray.remote(num_cpus=CPUS, max_retries=0)(run_job)
            job_of = {task.remote(job, arguments): job for job in jobs}
            waiting = list(job_of)
            try:
                while waiting:
                    ready, waiting = ray.wait(waiting)
                    for reference in ready:
                        yield _outcome(ray, reference, job_of[reference])
            finally:
                stop(ray, waiting)  # the reconstructions under way keep what is done

    return pool


def _outcome(ray, reference, job: Job) -> Outcome:  # type: ignore[no-untyped-def] # Ray is an extra
    try:
        outcome: Outcome = ray.get(reference)
        return outcome
    except ray.exceptions.RayError as error:  # the worker or its node died
        reason = str(error).splitlines()[0]
        return Outcome(str(job.video), str(job.folder), "failed", message=f"its Ray task died: {reason}")
