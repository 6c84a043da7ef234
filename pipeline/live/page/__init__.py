"""What the page of a live session is told, and the server that tells it."""
