#!/bin/sh
# The report's tests open it in a browser. On Debian or Ubuntu as root this installs Chromium; elsewhere those tests are
# skipped where none is found, and nothing here fails.
set -eu

for name in chromium chromium-browser google-chrome; do
    if command -v "$name" >/dev/null 2>&1; then exit 0; fi
done
if command -v apt-get >/dev/null 2>&1 && [ "$(id -u)" = 0 ]; then
    echo "installing chromium for the tests of the report"
    if apt-get update -qq && DEBIAN_FRONTEND=noninteractive apt-get -o DPkg::Lock::Timeout=120 install -y -qq --no-install-recommends \
        chromium fonts-dejavu-core >/dev/null; then exit 0; fi
fi
echo "no Chromium: the tests of the report in a browser are skipped (Debian/Ubuntu: sudo apt-get install chromium)"
