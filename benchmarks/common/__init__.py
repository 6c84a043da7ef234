"""What the benchmarks share: their command line and record, their inputs, and the peers that they are run beside."""
