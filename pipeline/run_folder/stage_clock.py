"""Seconds, CPU seconds and peak memory of a run's stages, for `--profile`."""

import sys
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass
from typing import Any, ParamSpec, TypeVar

Arguments = ParamSpec("Arguments")
Result = TypeVar("Result")
KIB = 1024


@dataclass(frozen=True)
class StageTime:
    """seconds: wall time. cpu_seconds: of this process's threads and of the processes that it started and that ended
    meanwhile; what another stage left running in the background counts here too. peak_mib: most resident memory of this
    process until the stage's end, MiB."""

    stage: str
    seconds: float
    cpu_seconds: float
    peak_mib: float


class StageClock:
    """Call it with a stage's function to get one that does the same and is timed."""

    def __init__(self) -> None:
        self.times: list[StageTime] = []

    def __call__(self, stage: str, function: Callable[Arguments, Result]) -> Callable[Arguments, Result]:
        def timed(*args: Arguments.args, **kwargs: Arguments.kwargs) -> Result:
            started, cpu = time.perf_counter(), _cpu_seconds()
            result = function(*args, **kwargs)
            seconds, used = time.perf_counter() - started, _cpu_seconds() - cpu
            self.times.append(StageTime(stage, seconds, used, _peak_mib()))
            return result

        return timed

    def to_list(self) -> list[dict[str, Any]]:
        """For `metrics.json`, in the order of the stages."""
        return [asdict(one) for one in self.times]


def _cpu_seconds() -> float:
    import resource  # here and not above: Windows has none

    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(one.ru_utime + one.ru_stime for one in used)


def _peak_mib() -> float:
    import resource

    unit = 1 if sys.platform == "darwin" else KIB  # bytes there, KiB on Linux
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / KIB**2
