"""Whether a submap is wrong, by what the front end leaves of it."""
