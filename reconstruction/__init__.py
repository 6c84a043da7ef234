"""Dense depth and poses in, a measured surface out. Importing this package imports nothing heavy."""
