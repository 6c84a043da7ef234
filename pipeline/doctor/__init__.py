"""What this machine has of what `reconstruct` needs, and whether it works: the text of a bug report."""
