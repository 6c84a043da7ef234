"""The networks that the paper compares with MSCSA-Net: Sparse-to-Dense, NLSPN and GAENet, from their papers and codes."""
