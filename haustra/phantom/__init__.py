"""A synthetic gut that knows its own truth: geometry, texture, light, motion; it imports nothing of ours."""
