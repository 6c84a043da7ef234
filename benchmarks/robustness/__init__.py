"""Bad input: damaged and adversarial videos and camera files."""
