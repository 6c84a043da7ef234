"""Milliseconds, frames per second and memory."""
