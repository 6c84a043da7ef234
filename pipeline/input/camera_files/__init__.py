"""Camera calibrations as other programs write them: one reader a format, and one table of them (`registry`)."""
