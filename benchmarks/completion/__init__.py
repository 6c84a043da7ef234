"""Depth completion: measurements of its errors."""
