"""Metric depth of a sensor beside the pictures: read, tested against the map, its scale, and its points."""
