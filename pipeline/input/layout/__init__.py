"""How the processor shows its picture: where on the screen, how large, and how much of it."""
