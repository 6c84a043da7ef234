"""Poses and surface: measurements of the whole pipeline and of its front ends."""
