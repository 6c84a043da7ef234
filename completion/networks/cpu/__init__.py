"""Faster equivalents of network parts for inference on a CPU: convolutions in int8 or fused with their ReLU by oneDNN,
normalised convolution and the resampling around the U-Net as numba loops. A network uses them in its `for_device`."""
