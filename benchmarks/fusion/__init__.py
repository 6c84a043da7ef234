"""What depth, and each part of the fusion, is worth to the mesh."""
