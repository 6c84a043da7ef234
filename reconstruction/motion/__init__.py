"""Walls that move: depth carried to the wall at another time."""
