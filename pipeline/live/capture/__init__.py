"""Where live frames come from: films at their own rate, cameras, streams, growing files; and what records them."""
