"""Processes that a test started, and waiting for what they do."""

import time

import psutil


def alive(folder):
    """Processes whose command names the folder."""
    found = psutil.process_iter(["cmdline", "status"])
    return [
        p
        for p in found
        if any(str(folder) in word for word in p.info["cmdline"] or []) and p.info["status"] != "zombie"
    ]


def wait_for(condition, seconds=120):
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end, "it never came to pass"
        time.sleep(0.05)
