"""Loop closure and the joining of submaps."""
