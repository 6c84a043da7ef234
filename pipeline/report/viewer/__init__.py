"""`haustra view FOLDER`: the runs of a folder in a browser: a list, a player and a comparison of two."""
