"""Depth images of a sensor beside the pictures, read and looked up; what is done with them is not known here."""
