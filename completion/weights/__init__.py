"""Trained weights that come with the package, as safetensors files (`MODEL_CARD.md`), and their names."""
