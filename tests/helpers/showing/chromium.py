"""A headless Chromium for tests that click, and patience with it."""

import shutil
import time

CHROMIUM = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
# WebGL without a graphics card is SwiftShader's; the others keep the browser from calling home.
FLAGS = (
    *("--headless", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run", "--disable-sync"),
    *("--disable-background-networking", "--disable-component-update"),
    *("--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"),
)
PATIENCE_MS = 60_000  # a busy machine draws slowly; nothing here waits without need
HARMLESS = ("willReadFrequently", "GPU stall")  # plotly's and the software renderer's remarks on speed


def until(page, condition):
    """Wait on this side: playwright's own waits for a function need `eval`, which the pages' policies forbid."""
    end = time.monotonic() + PATIENCE_MS / 1000
    while not condition():
        assert time.monotonic() < end, "it never came to pass"
        page.wait_for_timeout(50)


def complaints(said):
    return [text for text in said if not any(word in text for word in HARMLESS)]
