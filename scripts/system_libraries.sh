#!/bin/sh
# Open3D's wheel links libEGL, libGL, libX11 and libgomp of the system, even where nothing is drawn on a screen.
# Desktop systems have them; on a bare Debian or Ubuntu this installs them, or says which ones are missing.
set -eu

[ "$(uname -s)" = Linux ] || exit 0

missing=""
for pair in libEGL.so.1:libegl1 libGL.so.1:libgl1 libX11.so.6:libx11-6 libgomp.so.1:libgomp1; do
    library=${pair%%:*}
    if ! ldconfig -p 2>/dev/null | grep -q "$library" && ! /sbin/ldconfig -p 2>/dev/null | grep -q "$library"; then
        missing="$missing ${pair##*:}"
    fi
done
[ -n "$missing" ] || exit 0

if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
    echo "installing system libraries:$missing"
    apt-get update -qq
    # shellcheck disable=SC2086 - a list of words
    DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=120 install -y -qq --no-install-recommends $missing >/dev/null
else
    echo "error: system libraries are missing; install them first (Debian/Ubuntu: sudo apt-get install$missing)" >&2
    exit 1
fi
