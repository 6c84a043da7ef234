"""The networks that the paper compares with MSCSA-Net: Sparse-to-Dense, NLSPN, GAENet; each a row of the registry."""
