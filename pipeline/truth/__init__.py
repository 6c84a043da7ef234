"""Truth of published data sets as it lies on disk, for `haustra compare`: one reader a data set, and one table."""
