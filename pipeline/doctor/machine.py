"""Findings about a machine: processor, memory, disk, libraries, FFmpeg, GPU. Nothing names a person or a path."""

import importlib.metadata
import importlib.util
import os
import platform
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from haustra.core.threads import processors

Verdict = Literal["ok", "note", "fault"]
MIN_MEMORY_GB = 4.0  # of a film of some minutes; the demo clip needs half of it
MIN_DISK_GB = 2.0  # a minute of film makes some 0.5
IMPORT_S = 120.0
# What is imported, and the distribution that it is of. In a process each: pycolmap first makes OpenCV's PNG writer
# abort, and a library of the system that is missing must be told, not end this.
LIBRARIES = {
    "numpy": "numpy",
    "scipy": "scipy",
    "cv2": "opencv-python-headless",
    "av": "av",
    "torch": "torch",
    "numba": "numba",
    "open3d": "open3d",
    "pycolmap": "pycolmap",
    "gtsam": "gtsam",
}
IMPORTS = {"open3d": "from reconstruction.mesh.open3d_import import import_open3d as load; load()"}  # as we do it
OPTIONAL = {"pydicom": "DICOM films", "rerun": "recordings for Rerun", "ray": "clusters", "OpenEXR": "VR-Caps' depth"}
FEATURES = {
    "avx2": "needed by PyTorch's and Open3D's fast code; without it everything is several times slower",
    "avx512f": "wide vectors: depth completion is faster",
    "avx512_vnni": "depth completion in 8 bits, the fastest; without it in 32",
    "avx512_bf16": "depth completion in 16 bits, if 8 are not to be had",
}
DECODERS = ("h264", "hevc", "mpeg2video", "mpeg4", "mjpeg", "vp9", "av1", "prores", "dvvideo", "jpeg2000")


@dataclass(frozen=True)
class Finding:
    """One line: what was looked at, what it is, and what that means where it is not as it should be."""

    subject: str
    value: str
    verdict: Verdict = "ok"
    meaning: str = ""

    def __str__(self) -> str:
        mark = {"ok": " ", "note": "-", "fault": "!"}[self.verdict]
        return f"{mark} {self.subject:12} {self.value}" + (f": {self.meaning}" if self.meaning else "")


def processor(text: str | None = None) -> list[Finding]:
    """Model, usable cores and what its instructions are good for; text: of /proc/cpuinfo, read if not given."""
    path = Path("/proc/cpuinfo")
    text = text if text is not None else path.read_text() if path.exists() else ""
    rows = [line.partition(":")[::2] for line in text.splitlines()]
    values = {name.strip(): value.strip() for name, value in reversed(rows)}
    model = values.get("model name", platform.processor() or platform.machine())
    flags = set(values.get("flags", values.get("Features", "")).split())
    found = [Finding("processor", f"{model}, {processors()} cores usable of {os.cpu_count()}")]
    if not flags & {"sse2", *FEATURES}:
        return [*found, Finding("instructions", "unknown", "note", "not an x86 processor, or not Linux")]
    for name, meaning in FEATURES.items():
        there = name in flags
        absent: Verdict = "fault" if name == "avx2" else "note"
        found.append(Finding(name, "yes" if there else "no", "ok" if there else absent, "" if there else meaning))
    return found


def memory() -> Finding:
    """Memory of the machine, or of the container where that has less."""
    path = Path("/proc/meminfo")
    if not path.exists():
        return Finding("memory", "unknown", "note", "not Linux")
    rows = dict(line.split(":", 1) for line in path.read_text().splitlines())
    total, free = (int(rows[name].split()[0]) / 2**20 for name in ("MemTotal", "MemAvailable"))
    limit = Path("/sys/fs/cgroup/memory.max")
    if limit.exists() and (stated := limit.read_text().strip()).isdigit():
        total = min(total, int(stated) / 2**30)
    short = total < MIN_MEMORY_GB
    meaning = f"below {MIN_MEMORY_GB:g} GB long films end for want of memory: try --fast, or parts by --start and --end"
    return Finding("memory", f"{total:.1f} GB, {free:.1f} free", "note" if short else "ok", meaning if short else "")


def disk(folder: Path) -> Finding:
    """Free space where runs would be written."""
    free = shutil.disk_usage(folder).free / 2**30
    short = free < MIN_DISK_GB
    return Finding("disk here", f"{free:.0f} GB free", "note" if short else "ok", "a run may not fit" if short else "")


def libraries() -> list[Finding]:
    """Each library's version, and whether it can be imported."""
    return [_library(module, name) for module, name in LIBRARIES.items()] + [_extras()]


def _library(module: str, name: str) -> Finding:
    try:
        version = importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return Finding(module, "not installed", "fault", f"pip install {name}")
    # -P: a file of the same name in the working folder must not come first.
    command = [sys.executable, "-P", "-c", IMPORTS.get(module, f"import {module}")]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=IMPORT_S)
    except subprocess.TimeoutExpired:
        return Finding(module, version, "fault", f"its import takes more than {IMPORT_S:.0f} s")
    if done.returncode == 0:
        return Finding(module, version)
    last = (done.stderr.strip().splitlines() or [f"exit code {done.returncode}"])[-1]
    return Finding(module, version, "fault", f"cannot be imported ({last}); sh scripts/system_libraries.sh may help")


def _extras() -> Finding:
    there = [module for module in OPTIONAL if importlib.util.find_spec(module) is not None]
    absent = [f"{module} ({use})" for module, use in OPTIONAL.items() if module not in there]
    return Finding("extras", ", ".join(there) or "none", "ok", f"not installed: {', '.join(absent)}" if absent else "")


def ffmpeg() -> Finding:
    """PyAV's FFmpeg, and the decoders that films of endoscopes need."""
    import av

    absent = [name for name in DECODERS if name not in av.codecs_available]
    version = ".".join(map(str, av.library_versions["libavcodec"]))
    value = f"libavcodec {version}, decoders for {', '.join(name for name in DECODERS if name not in absent)}"
    meaning = f"films in {', '.join(absent)} cannot be read" if absent else ""
    return Finding("ffmpeg", value, "note" if absent else "ok", meaning)


def gpu() -> Finding:
    """Whether PyTorch sees one. It is not needed."""
    import torch

    if not torch.cuda.is_available():
        return Finding("gpu", "none", "ok", "not needed; one would speed up depth completion alone")
    return Finding("gpu", f"{torch.cuda.get_device_name()}, CUDA {torch.version.cuda}")


def versions() -> list[Finding]:
    """Versions of the project, Python and the system."""
    try:
        version = importlib.metadata.version("haustra")
    except importlib.metadata.PackageNotFoundError:
        version = "not installed"
    return [
        Finding("haustra", version),
        Finding("python", platform.python_version()),
        Finding("system", f"{platform.system()} {platform.release()}, {platform.machine()}"),
    ]
