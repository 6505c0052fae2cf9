"""Recorded movements and paths, and their changes by errors in the inputs of inverse dynamics."""
