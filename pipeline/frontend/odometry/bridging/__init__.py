"""Maps joined over a stretch that shows nothing, by registration of what a depth sensor measured in it."""
