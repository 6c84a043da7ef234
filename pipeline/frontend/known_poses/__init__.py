"""Front end `poses`: poses that are given, tested against the pictures, and the points that they triangulate."""
