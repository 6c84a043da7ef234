"""One chunk of a video, tracked in a process of its own: `... track JOB.json`."""

import json
import sys
from pathlib import Path
from typing import Any

from haustra.core.camera import Camera
from haustra.core.ray_table import RayTable
from haustra.core.threads import single_threaded
from pipeline.frontend.odometry.frame_io import frame_reader
from pipeline.frontend.odometry.tracking import Odometry
from pipeline.mapping.map_io import save_maps
from pipeline.run_folder.workspace import Workspace, write_json

STEP = 10  # frames between two words on how far it is


def track(job: dict[str, Any]) -> int:
    """Track the frames of `job` (see `chunks.jobs_of`), leave the maps at its output; how many frames it had."""
    read = frame_reader(Workspace(Path(job["run"])))
    rays = RayTable(Camera.from_dict(job["camera"]))
    odometry = Odometry(rays, job["seed"], job["stride"], job["keyframe_motion"])
    with single_threaded():
        for done, frame in enumerate(job["frames"], start=1):
            rgb, mask = read(frame)
            odometry.process(frame, rgb, odometry.view(rgb, mask))
            if done % STEP == 0 or done == len(job["frames"]):
                print(done, len(job["frames"]), flush=True)
        output = Path(job["output"])
        save_maps(odometry.finish(), output)
    write_json(output.with_suffix(".json"), job)  # last: it says that the maps are whole
    return len(job["frames"])


def main() -> None:
    action, job_file = sys.argv[1:]
    job = json.loads(Path(job_file).read_text())
    {"track": track}[action](job)


if __name__ == "__main__":
    main()
