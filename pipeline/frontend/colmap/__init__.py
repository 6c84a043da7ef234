"""Front end `sfm`: COLMAP's SIFT, matching and global or incremental mapping, in a process of its own (`worker`)."""
