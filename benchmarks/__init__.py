"""Measurements, one entry point a question: `python -m benchmarks.NAME --help`. Not installed with the packages."""
