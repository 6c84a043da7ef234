#!/bin/sh
# The image's steps in a fresh environment, as far as they go without Docker: the sdist, a wheel from it, installed into an
# empty environment; the demo from there, cut short, and the entry point with the clip's first second, both without a
# network where `unshare` can take it away.
#   sh scripts/check_image.sh [WORK]
set -eu

root=$(cd "$(dirname "$0")/.." && pwd)
work=${1-$(mktemp -d)}
mkdir -p "$work"
work=$(cd "$work" && pwd) # steps change folders
export PIP_TORCH="${PIP_TORCH-}"

[ -x "$work/tools/bin/python" ] || "${PYTHON-python3}" -m venv "$work/tools"
PATH="$work/tools/bin:$PATH"
python3 -m pip install --quiet --disable-pip-version-check build

echo "== sources as git has them"
rm -rf "$work/src" && mkdir "$work/src"
git -C "$root" archive HEAD | tar x -C "$work/src"

echo "== sdist and wheel"
rm -rf "$work/wheels" "$work/sdist"
(cd "$work/src" && python3 -m build --sdist --quiet --outdir "$work/sdist" .)
python3 -m tarfile -l "$work"/sdist/haustra-*.tar.gz >"$work/sdist.list"
sh "$work/src/scripts/image_steps.sh" wheel "$work"/sdist/haustra-*.tar.gz "$work/wheels"
python3 -m zipfile -l "$work"/wheels/haustra-*.whl >"$work/wheel.list"
for needed in pipeline/demo/video.mp4 completion/weights/mscsa.safetensors pipeline/report/page/report.js \
    haustra/core/endomapper_scopes.json pipeline/report/viewer/player.html pipeline/live/page/live.html; do
    grep -q "$needed" "$work/wheel.list" || { echo "error: the wheel lacks $needed" >&2 && exit 1; }
done

echo "== an empty environment"
[ -x "$work/venv/bin/haustra" ] || sh "$work/src/scripts/image_steps.sh" install "$work/venv" "$work/wheels" "$root/constraints.txt"
"$work/venv/bin/pip" install --quiet --no-deps --force-reinstall "$work"/wheels/haustra-*.whl
cd "$work" # not in the checkout, whose packages would come first
PATH="$work/venv/bin:$PATH"
HOME="$work/home" NUMBA_CACHE_DIR="$work/numba" MPLCONFIGDIR="$work/matplotlib"
export PATH HOME NUMBA_CACHE_DIR MPLCONFIGDIR
unset PYTHONPATH
python -P -c "import pipeline; assert 'venv' in pipeline.__file__, pipeline.__file__"
haustra doctor --no-test
offline=""
if unshare --user --map-root-user --net true 2>/dev/null; then offline="unshare --user --map-root-user --net"; fi

echo "== the demo, its first second"
$offline reconstruct --demo --end 1 --front-end odometry -o "$work/demo_run" --overwrite >"$work/demo.out" 2>&1 ||
    { cat "$work/demo.out" >&2 && exit 1; }
grep "posed\|ATE" "$work/demo.out"
grep -q "30 of 30 posed" "$work/demo.out" || { echo "error: the demo posed other than 30 frames" >&2 && exit 1; }

echo "== CLiMB's contract"
rm -rf "$work/input" "$work/output" && mkdir "$work/input"
python - "$work/input/clip.mp4" <<'PY'
import sys

import av

from pipeline.demo import VIDEO

with av.open(str(VIDEO)) as source, av.open(sys.argv[1], "w") as target:
    stream = target.add_stream("libx264", rate=30)
    stream.width = stream.height = 320
    for _, frame in zip(range(30), source.decode(video=0)):
        target.mux(stream.encode(av.VideoFrame.from_ndarray(frame.to_ndarray(format="rgb24"), format="rgb24")))
    target.mux(stream.encode())
PY
$offline sh "$work/src/scripts/image_steps.sh" run climb "$work/input" "$work/output" --runs 1
for file in camera_trajectory/cam_traj_map_000.txt 3D_maps/000/points3D.txt runtime.txt; do
    [ -s "$work/output/clip/1/$file" ] || { echo "error: clip/1/$file is missing" >&2 && exit 1; }
done
echo "the image's steps work"
