"""Walls that move: what the points of a map that takes them for still say of it."""
