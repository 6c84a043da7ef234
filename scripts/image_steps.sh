#!/bin/sh
# The steps of the image, each of which also runs without Docker: check_image.sh does.
#   wheel SOURCE WHEELS                  build the project's wheel
#   install VENV WHEELS CONSTRAINTS      an environment with it and what it needs, exactly as constrained, torch for CPUs
#   run [COMMAND ...]                    the entry point: without a command CLiMB's contract, /input/*.mp4 to /output
set -eu

step=$1
shift
case $step in
wheel)
    python3 -m pip wheel --quiet --no-deps --wheel-dir "$2" "$1"
    ;;
install)
    python3 -m venv "$1"
    "$1/bin/pip" install --quiet --no-cache-dir -c "$3" ${PIP_TORCH---index-url https://download.pytorch.org/whl/cpu} torch
    "$1/bin/pip" install --quiet --no-cache-dir -c "$3" "$2"/haustra-*.whl
    ;;
run)
    case ${1-} in
    "") exec haustra climb ;;
    reconstruct) exec "$@" ;;
    sh | bash | python) exec "$@" ;;
    *) exec haustra "$@" ;;
    esac
    ;;
*)
    echo "error: a step is wheel, install or run" >&2
    exit 2
    ;;
esac
